// Builds the client into the Python package. usage: node build.mjs [FOLDER]    default: ../src/drsplat/fronts/viewing
import { build } from "esbuild";
import { createHash } from "node:crypto";
import { readdirSync, readFileSync, statSync, writeFileSync } from "node:fs";
import { dirname, join, relative } from "node:path";
import { fileURLToPath } from "node:url";

const here = dirname(fileURLToPath(import.meta.url)), folder = process.argv[2] ?? join(here, "../src/drsplat/fronts/viewing");
const common = { bundle: true, minify: true, format: "iife", target: "es2022", charset: "utf8", legalComments: "none", write: false };

const worker = await build({ ...common, entryPoints: [join(here, "src/drawing/worker.ts")] });
const asText = {
  name: "worker",
  setup(set) {
    set.onResolve({ filter: /^worker-text$/ }, (found) => ({ path: found.path, namespace: "worker" }));
    set.onLoad({ filter: /.*/, namespace: "worker" }, () => ({ contents: worker.outputFiles[0].text, loader: "text" }));
  },
};
const client = await build({ ...common, entryPoints: [join(here, "src/main.ts")], plugins: [asText] });

/** The sources in a fixed order, so that a test without npm can tell whether what is committed was built from them. */
export function sources(top) {
  const files = readdirSync(top, { recursive: true }).map((name) => join(top, name)).filter((path) => statSync(path).isFile());
  return files.map((path) => relative(here, path).replaceAll("\\", "/")).sort();
}
const hash = createHash("sha256");
for (const name of [...sources(join(here, "src")), "build.mjs", "package.json"]) hash.update(`${name}\n`).update(readFileSync(join(here, name)));
writeFileSync(join(folder, "client.js"), `// Built from web/ (sha256 of the sources: ${hash.digest("hex")}); do not edit.\n${client.outputFiles[0].text}`);
