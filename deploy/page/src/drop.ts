/** Cubes and solids into a scene: JSON, NDJSON, or cubes as CSV. */

import { type Scene, Refused, ask, scenePath, send } from "./api";
import { h, replace } from "./dom";
import { count } from "./format";

/** Cubes of CSV that are one change. */
const CHANGE_CUBES = 100_000;

export function drop(scene: Scene): HTMLElement {
    const solids = scene.kind === "solids" || scene.solids !== undefined;
    const example = solids
        ? '{"insert": [{"id": 1, "shape": "t1", "from": [10, 10, -2], "to": [50, 10, -2]}]}'
        : "id,x,y,z\n1,0,0,0\n2,3,0,0";
    const formats: [string, string][] = [["application/json", "JSON: one change"], ["application/x-ndjson", "NDJSON: a line each"]];
    if (!solids) formats.unshift(["text/csv", "CSV: x,y,z or id,x,y,z"]);
    const format = h("select", { id: "format" }, formats.map(([value, name]) => h("option", { value }, name)));
    const text = h("textarea", { id: "bodies", rows: 5, spellcheck: "false", placeholder: example });
    const file = h("input", { type: "file", id: "file", accept: ".json,.ndjson,.jsonl,.csv,.txt" });
    const said = h("div", { role: "status", class: "said" });
    const button = h("button", { class: "primary" }, "Insert");
    const form = h("form", { class: "card", "aria-labelledby": "drop-title" },
        h("h2", { id: "drop-title" }, solids ? "Add solids" : "Add cubes"),
        h("div", { class: "field" }, h("label", { for: "format" }, "Format"), format),
        h("div", { class: "field" }, h("label", { for: "bodies" }, "Type them"), text),
        h("div", { class: "field" }, h("label", { for: "file" }, "or drop a file here"), file),
        said, h("div", { class: "row end" }, button));
    const guess = (name: string): void => {
        const kind = /\.csv$|\.txt$/i.test(name) ? "text/csv" : /\.(ndjson|jsonl)$/i.test(name) ? "application/x-ndjson" : "application/json";
        if (formats.some(([value]) => value === kind)) format.value = kind;
    };
    file.addEventListener("change", () => guess(file.files?.[0]?.name ?? ""));
    for (const name of ["dragover", "dragleave", "drop"]) {
        form.addEventListener(name, (event) => {
            event.preventDefault();
            form.classList.toggle("over", name === "dragover");
            const dropped = (event as DragEvent).dataTransfer?.files;
            if (name === "drop" && dropped?.length) {
                file.files = dropped;
                guess(dropped[0]!.name);
            }
        });
    }
    form.addEventListener("submit", async (event) => {
        event.preventDefault();
        const source: Blob | null = file.files?.[0] ?? (text.value.trim() ? new Blob([text.value]) : null);
        if (!source) return replace(said, h("p", { class: "wrong" }, "Type something, or choose a file."));
        button.disabled = true;
        replace(said, "Sending …");
        try {
            replace(said, await insert(scene.name, format.value, source));
            form.reset();
        } catch (error) {
            const lines = error instanceof Refused ? error.lines() : [(error as Error).message];
            replace(said, lines.slice(0, 12).map((line) => h("p", { class: "wrong" }, line)),
                lines.length > 12 ? h("p", { class: "wrong" }, `and ${lines.length - 12} more`) : null);
        } finally {
            button.disabled = false;
        }
    });
    return form;
}

interface Outcome {
    seq?: number;
    inserted?: number;
    deleted?: number;
    unchanged?: number;
}

async function insert(scene: string, kind: string, source: Blob): Promise<string> {
    const path = `${scenePath(scene)}/changes?return=minimal`;
    if (kind !== "text/csv") {
        const answer = await ask(path, { method: "POST", headers: { "content-type": kind }, body: source });
        return said((await answer.json()) as Outcome);
    }
    const cubes = readCsv(await source.text());
    const sum: Outcome = { inserted: 0, unchanged: 0 };
    for (let first = 0; first < cubes.length; first += CHANGE_CUBES) {
        const answer = await send("POST", path, { insert: cubes.slice(first, first + CHANGE_CUBES) });
        const outcome = (await answer.json()) as Outcome;
        sum.seq = outcome.seq;
        sum.inserted! += outcome.inserted ?? 0;
        sum.unchanged! += outcome.unchanged ?? 0;
    }
    return said(sum);
}

const said = ({ seq, inserted = 0, deleted = 0, unchanged = 0 }: Outcome): string =>
    `${count(inserted)} inserted, ${count(deleted)} deleted, ${count(unchanged)} unchanged${seq === undefined ? "" : `; seq ${count(seq)}`}`;

/** Rows of `x,y,z` or `id,x,y,z`; a first row without numbers is a heading. Ids stay text: they may be above 2^53. */
export function readCsv(text: string): { id?: string; at: number[] }[] {
    const lines = text.split(/\r?\n/);
    const cubes: { id?: string; at: number[] }[] = [];
    let width = 0;
    lines.forEach((line, index) => {
        if (line.trim() === "" || line.startsWith("#")) return;
        const cells = line.split(/[,;\t]/).map((cell) => cell.trim());
        if (cubes.length === 0 && width === 0 && cells.every((cell) => Number.isNaN(Number(cell)))) return;
        if (cells.length !== 3 && cells.length !== 4) throw new Error(`line ${index + 1} has ${cells.length} values: 3 or 4 are wanted`);
        width ||= cells.length;
        if (cells.length !== width) throw new Error(`line ${index + 1} has ${cells.length} values, the ones before ${width}`);
        const at = cells.slice(-3).map((cell) => {
            const value = Number(cell);
            if (cell === "" || !Number.isFinite(value)) throw new Error(`line ${index + 1}: ${JSON.stringify(cell)} is not a number`);
            return value;
        });
        cubes.push(cells.length === 4 ? { id: cells[0]!, at } : { at });
    });
    if (cubes.length === 0) throw new Error("there are no rows");
    return cubes;
}
