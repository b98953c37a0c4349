import { defineConfig } from "vite";

// Names without a hash: the program embeds the files by name and answers with an ETag.
export default defineConfig({
    build: {
        outDir: "dist",
        target: "es2022",
        modulePreload: false,
        assetsInlineLimit: 0,
        rolldownOptions: {
            output: {
                entryFileNames: "assets/page.js",
                chunkFileNames: "assets/[name].js",
                assetFileNames: "assets/page[extname]",
            },
        },
    },
});
