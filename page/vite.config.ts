import { defineConfig } from "vite";

// into the package; the folder is not committed, wheels hold it
export default defineConfig({
  base: "./",
  build: {
    outDir: "../src/feeddrive/studio/page",
    emptyOutDir: true,
    assetsDir: "",
    assetsInlineLimit: 0,
    modulePreload: false,
    chunkSizeWarningLimit: 1500,
    rollupOptions: { output: { entryFileNames: "page.js", assetFileNames: "page.[ext]" } },
  },
});
