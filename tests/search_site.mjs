// Asks the search of a built site: node search_site.mjs SITE, queries as a JSON list on the input, addresses on the output.
// The worker is the theme's own, given what a browser would give it.
import { readdirSync, readFileSync } from "node:fs";
import { join } from "node:path";
import vm from "node:vm";

const site = process.argv[2];
const workers = join(site, "assets/javascripts/workers");
const script = readdirSync(workers).find((name) => /^search\..*\.js$/.test(name));
let listener;
const answers = [];
const scope = { addEventListener: (_, heard) => (listener = heard), postMessage: (answer) => answers.push(answer), console };
scope.self = scope;
vm.runInNewContext(readFileSync(join(workers, script), "utf8"), scope);
const ask = async (type, data) => {
  await listener({ data: { type, data } });
  return answers.pop().data;
};
const index = JSON.parse(readFileSync(join(site, "search/search_index.json"), "utf8"));
await ask(0, { ...index, options: {} });
const found = [];
for (const query of JSON.parse(readFileSync(0, "utf8"))) {
  const { items } = await ask(2, query);
  found.push(items.slice(0, 8).map((entries) => entries.find((entry) => entry.score > 0)?.location ?? ""));
}
process.stdout.write(JSON.stringify(found));
