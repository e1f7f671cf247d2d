// Builds the page into the package; the folder is not committed, wheels hold it.
import { copyFile } from "node:fs/promises";
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
await copyFile("node_modules/uplot/LICENSE", `${out}/uPlot.LICENSE.txt`); // of what is bundled
