/** All scenes and their state, and the form for a new one. */

import { type Scene, Refused, Unreachable, json, pause, scenePath, send } from "./api";
import { field, h, mark, replace } from "./dom";
import { brief, count, counted, unitTo } from "./format";
import { go, trouble, type View } from "./main";

/** How often the list is asked for. */
const EVERY_MS = 2000;

export const list: View = async (main, _crumbs, signal) => {
    document.title = "Scenes · union3d";
    const summary = h("p", { class: "note" }, "Asking the server …");
    const filter = h("input", { type: "search", id: "filter", placeholder: "Find a scene", "aria-label": "Find a scene by its name" });
    const rows = h("tbody");
    const table = h(
        "table",
        { class: "scenes" },
        h("thead", {}, h("tr", {}, ["Scene", "State", "Kind", "Bodies", "Volume", "Unit", "Seq"].map((name, column) =>
            h("th", { scope: "col", class: column > 2 && column !== 5 ? "figure" : "" }, name)))),
        rows,
    );
    const none = h("div", { class: "empty", hidden: true }, h("h2", {}, "No scenes yet"),
        h("p", {}, "A scene is a set of cubes or of solids whose union is measured. Create one here, or stream one in with ", h("code", {}, "union3d mill"), "."));
    const found = h("div", { class: "scroll" }, table);
    replace(
        main,
        h("div", { class: "columns list" },
            h("section", { class: "card wide", "aria-labelledby": "scenes-title" },
                h("div", { class: "row" }, h("h1", { id: "scenes-title" }, "Scenes"), h("span", { class: "grow" }), filter), summary, found, none),
            creation()),
    );
    let scenes: Scene[] = [];
    const volumes = new Map<string, { seq: number | null; text: string }>();
    const draw = (): void => {
        const wanted = filter.value.trim().toLowerCase();
        const shown = scenes.filter((scene) => scene.name.includes(wanted));
        const running = scenes.filter((scene) => scene.state === "running").length;
        summary.textContent = scenes.length === 0 ? "" : `${counted(scenes.length, "scene")}, ${count(running)} running` +
            (wanted ? `, ${count(shown.length)} with this name` : "");
        none.hidden = scenes.length > 0;
        found.hidden = filter.hidden = scenes.length === 0;
        const before = new Map([...rows.children].map((row) => [(row as HTMLElement).dataset["name"], row as HTMLElement]));
        rows.replaceChildren(...shown.map((scene) => row(scene, volumes.get(scene.name)?.text ?? "", before.get(scene.name))));
    };
    filter.addEventListener("input", draw);
    while (!signal.aborted) {
        try {
            const answer = await json<{ scenes: Scene[] }>("/v1/scenes", { signal });
            scenes = answer.scenes;
            trouble("");
            draw();
            // The volume is no part of the list: it is asked for where a scene has changed, a few at a time.
            const stale = scenes.filter((scene) => scene.state === "running" && volumes.get(scene.name)?.seq !== scene.seq);
            for (let first = 0; first < stale.length && !signal.aborted; first += 8) {
                await Promise.all(stale.slice(first, first + 8).map(async (scene) => {
                    const totals = await json<{ volume: number }>(`${scenePath(scene.name)}/mass-properties`, { signal }).catch(() => null);
                    if (totals) volumes.set(scene.name, { seq: scene.seq, text: brief(totals.volume) });
                }));
                if (!signal.aborted) draw();
            }
        } catch (error) {
            if (signal.aborted) return;
            trouble(error instanceof Unreachable ? "The server does not answer. What is shown is what it said last; it is asked again." :
                (error as Error).message);
        }
        await pause(EVERY_MS, signal);
    }
};

function row(scene: Scene, volume: string, before: HTMLElement | undefined): HTMLElement {
    const cells = [
        scene.solids === undefined ? "cubes" : "solids",
        scene.cubes ?? scene.solids,
        volume && scene.unit ? `${volume} ${unitTo(scene.unit, 3)}` : volume,
        scene.unit ? unitTo(scene.unit, 1) : "",
        scene.seq,
    ];
    const text = JSON.stringify([scene.state, scene.percent, scene.cause, ...cells]);
    if (before?.dataset["text"] === text) return before;
    const state = scene.state === "recovering" ? `recovering, ${scene.percent ?? 0} %` : scene.state;
    const link = h("a", { href: `/scenes/${scene.name}` }, scene.name);
    return h("tr", { "data-name": scene.name, "data-text": text },
        h("th", { scope: "row" }, link),
        h("td", {}, h("span", { class: `state ${scene.state}`, title: scene.cause }, state), scene.cause ? h("small", { class: "cause" }, scene.cause) : null),
        h("td", {}, cells[0]),
        h("td", { class: "figure" }, typeof cells[1] === "number" ? count(cells[1]) : "–"),
        h("td", { class: "figure" }, cells[2] || "–"),
        h("td", {}, cells[3]),
        h("td", { class: "figure" }, typeof cells[4] === "number" ? count(cells[4]) : "–"),
    );
}

const input = (attributes: Record<string, unknown>): HTMLInputElement => h("input", { autocomplete: "off", ...attributes });

/** The form for a new scene. What is wrong is what the server says is wrong, at its place. */
function creation(): HTMLElement {
    const name = input({ required: true, pattern: "[a-z0-9][a-z0-9._\\-]{0,62}", placeholder: "part-7" });
    const kind = h("select", {}, h("option", { value: "solids" }, "solids: tools, sweeps, hulls"), h("option", { value: "cubes" }, "cubes of one size"));
    const edge = input({ inputmode: "decimal", value: "1" });
    const unit = input({ value: "mm" });
    const density = input({ inputmode: "decimal", value: "1" });
    const steps = input({ inputmode: "numeric", placeholder: "by default" });
    const stock = input({ type: "checkbox" });
    const from = input({ value: "0, 0, -10", inputmode: "text" });
    const to = input({ value: "80, 60, 0", inputmode: "text" });
    const shapes = h("textarea", { rows: 3, spellcheck: "false" }, '{"t1": {"flat": {"diameter": 6, "length": 25}}}');
    const edgeField = field("Edge", edge);
    const shapesField = field("Shapes", shapes, "of solids, as JSON");
    const stockFields = h("div", { class: "pair" }, field("Stock from", from, "x, y, z"), field("to", to, "x, y, z"));
    const said = h("div", { role: "alert", class: "said" });
    const fit = (): void => {
        edgeField.hidden = kind.value !== "cubes";
        shapesField.hidden = kind.value !== "solids";
        stockFields.hidden = !stock.checked;
    };
    kind.addEventListener("change", fit);
    stock.addEventListener("change", fit);
    const places: Record<string, HTMLElement> = {
        scene: name, edge, unit, density, steps_per_unit: steps, "stock/min": from, "stock/max": to, stock: from, shapes, kind,
    };
    const form = h("form", { class: "card", "aria-labelledby": "new-title", novalidate: true },
        h("h2", { id: "new-title" }, "New scene"),
        field("Name", name), field("Kind", kind), edgeField,
        h("div", { class: "pair" }, field("Unit", unit), field("Density", density)),
        field("Lattice steps per unit", steps), shapesField,
        h("label", { class: "check" }, stock, h("span", {}, "Cut from a stock")), stockFields, said,
        h("div", { class: "row end" }, h("button", { class: "primary" }, "Create")));
    fit();
    form.addEventListener("submit", async (event) => {
        event.preventDefault();
        Object.values(places).forEach((control) => mark(control, ""));
        replace(said);
        const numeric = (text: string): unknown => (text.trim() !== "" && Number.isFinite(Number(text)) ? Number(text) : text);
        const vector = (text: string): unknown => text.split(/[,;\s]+/).filter(Boolean).map(numeric);
        const body: Record<string, unknown> = { unit: unit.value, density: numeric(density.value) };
        if (steps.value.trim()) body["steps_per_unit"] = numeric(steps.value);
        if (stock.checked) body["stock"] = { min: vector(from.value), max: vector(to.value) };
        if (kind.value === "cubes") body["edge"] = numeric(edge.value);
        else {
            body["kind"] = "solids";
            try {
                if (shapes.value.trim()) body["shapes"] = JSON.parse(shapes.value);
            } catch (error) {
                mark(shapes, `is not JSON: ${(error as Error).message}`);
                shapes.focus();
                return;
            }
        }
        if (!name.value.trim()) {
            mark(name, "is needed: small letters, digits, and . _ - after the first");
            name.focus();
            return;
        }
        try {
            await send("PUT", scenePath(name.value.trim()), body);
            go(`/scenes/${encodeURIComponent(name.value.trim())}`);
        } catch (error) {
            show(error as Error, places, said);
        }
    });
    return form;
}

function show(error: Error, places: Record<string, HTMLElement>, said: HTMLElement): void {
    const left: string[] = [];
    let first: HTMLElement | undefined;
    for (const fault of error instanceof Refused ? error.errors : []) {
        const parts = (fault.pointer ?? fault.parameter ?? "").replace(/^\//, "").split("/");
        const control = places[parts.slice(0, 2).join("/")] ?? places[parts[0] ?? ""];
        const value = fault.value === undefined ? "" : ` (${JSON.stringify(fault.value)})`;
        if (control && !control.closest("[hidden]")) {
            mark(control, `${parts.slice(1).join("/")} ${fault.detail}${value}`.trim());
            first ??= control;
        } else left.push(`${parts.join("/")} ${fault.detail}${value}`.trim());
    }
    if (!first && left.length === 0) left.push(error.message);
    replace(said, left.map((line) => h("p", { class: "wrong" }, line)));
    first?.focus();
}
