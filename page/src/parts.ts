// Small makers of elements; all text is text, never markup.

type Attributes = Record<string, string>;

export function make<Kind extends keyof HTMLElementTagNameMap>(
  kind: Kind,
  attributes: Attributes = {},
  ...content: (string | Node)[]
): HTMLElementTagNameMap[Kind] {
  const found = document.createElement(kind);
  for (const [name, value] of Object.entries(attributes)) found.setAttribute(name, value);
  found.append(...content);
  return found;
}

export function button(text: string, act: () => void, attributes: Attributes = {}): HTMLButtonElement {
  const found = make("button", { type: "button", ...attributes }, text);
  found.addEventListener("click", act);
  return found;
}

const built = new WeakMap<HTMLElement, string>(); // from what the content of a place was built

// Build the content of a place again only if what it is built from has changed; the focus, and what somebody is
// writing, stay also then.
export function renew(place: HTMLElement, from: unknown, build: () => (string | Node)[]): void {
  const now = JSON.stringify(from);
  if (built.get(place) === now) return;
  built.set(place, now);
  const held = document.activeElement;
  const inside = held instanceof HTMLElement && held !== place && place.contains(held);
  place.replaceChildren(...build());
  if (!inside || held.isConnected) return;
  const same = [...place.querySelectorAll<HTMLElement>(held.tagName)].find((each) => called(each) === called(held));
  if (held instanceof HTMLInputElement && same instanceof HTMLInputElement && held.type === "text") {
    same.value = held.value;
    same.setSelectionRange(held.selectionStart, held.selectionEnd);
  }
  same?.focus({ preventScroll: true });
}

function called(element: HTMLElement): string {
  const text = element.tagName === "SELECT" ? "" : element.textContent;
  return element.id || (element.getAttribute("aria-label") ?? text ?? "");
}

// A table with a heading for each column.
export function table(heads: string[], rows: (string | Node)[][]): HTMLTableElement {
  const head = make("tr", {}, ...heads.map((each) => make("th", { scope: "col" }, each)));
  const body = rows.map((row) => make("tr", {}, ...row.map((each) => make("td", {}, each))));
  return make("table", {}, make("thead", {}, head), make("tbody", {}, ...body));
}

// A choice with its label.
export function choice(
  label: string,
  among: [value: string, text: string][],
  changed: (value: string) => void,
): HTMLLabelElement {
  const select = make("select", {}, ...among.map(([value, text]) => make("option", { value }, text)));
  select.addEventListener("change", () => changed(select.value));
  return make("label", { class: "choice" }, `${label} `, select);
}

// Text that the browser saves as a file.
export function save(text: string, name: string, kind = "text/plain"): void {
  const link = make("a", { download: name });
  link.href = URL.createObjectURL(new Blob([text], { type: kind }));
  link.click();
  URL.revokeObjectURL(link.href);
}

// Put a text on the clipboard, and say at the button whether the browser allowed it.
export async function copy(text: string, at: HTMLElement): Promise<void> {
  const done = await (navigator.clipboard?.writeText(text) ?? Promise.reject()).then(
    () => true,
    () => false,
  );
  at.dataset.said = done ? "copied" : "not allowed";
  setTimeout(() => delete at.dataset.said, 1500);
}

// A text that can be copied.
export function copied(title: string, text: string, id: string): HTMLElement {
  const said = make("span", { role: "status" });
  const copy = button(
    "Copy",
    () => {
      const done: Promise<void> = navigator.clipboard?.writeText(text) ?? Promise.reject(); // none without https
      void done.then(
        () => (said.textContent = " copied"),
        () => (said.textContent = " the browser does not allow it: select the text"),
      );
    },
    { "aria-label": `Copy: ${title}` },
  );
  return make(
    "section",
    { id },
    make("h2", {}, title, " "),
    copy,
    said,
    make("pre", { tabindex: "0", "aria-label": title }, text),
  );
}

// Words that a text field offers while one's own may be written; an input names its list by id.
export function offer(input: HTMLElement, words: string[]): HTMLElement[] {
  if (!words.length) return [];
  const id = `${input.id}-offered`;
  input.setAttribute("list", id);
  return [make("datalist", { id }, ...words.map((value) => make("option", { value })))];
}
