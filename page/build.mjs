// Builds the page into the package; the folder is not committed, wheels hold it.
import { copyFile, cp, rm } from "node:fs/promises";
import { build } from "esbuild";

const out = "../src/feeddrive/studio/page";
await build({
  entryPoints: { page: "src/main.ts", style: "src/page.css" },
  outdir: out,
  bundle: true,
  minify: true,
  format: "esm",
  target: "es2022",
  legalComments: "linked",
  logLevel: "warning",
});
await copyFile("index.html", `${out}/index.html`);
// what the search of the page reads
await rm(`${out}/docs`, { recursive: true, force: true });
await cp("../docs", `${out}/docs`, { recursive: true, filter: (each) => !/\.(?!md$)[a-z0-9]+$/.test(each) });
await copyFile("../GLOSSARY.md", `${out}/docs/GLOSSARY.md`);
await copyFile("node_modules/uplot/LICENSE", `${out}/uPlot.LICENSE.txt`); // of what is bundled
