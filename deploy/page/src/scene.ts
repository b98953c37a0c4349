/** One scene, live. */

import { type Scene, type Totals, Refused, ask, events, json, pause, scenePath, send } from "./api";
import { confirmed, h, replace } from "./dom";
import { drop } from "./drop";
import { count } from "./format";
import { History } from "./history";
import { go, trouble, type View } from "./main";
import { type Axis, Plots } from "./plots";
import { showTotals } from "./totals";
import { View3d } from "./view";

/** Least time between two questions for what is new in the history. */
const HISTORY_MS = 500;
/** How long to wait before asking again a server that went away: the first time, and at most. */
const AGAIN_MS = [500, 5000] as const;

export const scene =
    (name: string): View =>
    async (main, crumbs, signal) => {
        document.title = `${name} · union3d`;
        replace(crumbs, h("a", { href: "/" }, "Scenes"), h("span", { "aria-hidden": "true" }, " / "), name);
        for (let wait: number = AGAIN_MS[0]; !signal.aborted; wait = Math.min(AGAIN_MS[1], wait * 2)) {
            try {
                const found = await json<Scene>(scenePath(name), { signal });
                if (found.state === "running") {
                    trouble("");
                    return live(found, main, signal);
                }
                const progress = found.state === "recovering" ? `${found.percent ?? 0} % of it is replayed.` : (found.cause ?? "");
                replace(main, h("h1", {}, name), h("p", {}, h("span", { class: `state ${found.state}` }, found.state), ` ${progress}`));
            } catch (error) {
                if (signal.aborted) return;
                if (error instanceof Refused && error.status < 500) {
                    replace(main, h("h1", {}, error.title), h("p", {}, error.message), h("p", {}, h("a", { href: "/" }, "All scenes")));
                    return;
                }
                trouble(`${(error as Error).message}; it is asked again.`);
            }
            await pause(wait, signal);
        }
    };

function live(scene: Scene, main: HTMLElement, signal: AbortSignal): void {
    const history = new History();
    let newest: Totals | null = null;
    let chosen: number | null = null;
    const state = h("span", { class: "state running", role: "status" }, "live");
    const place = h("div", {});
    const view = new View3d(scene, scene.stock ? "remaining" : "union", signal);
    const plots = new Plots(history, scene.unit ?? "", Boolean(scene.stock), (seq) => choose(seq), signal);

    const slider = h("input", { type: "range", min: "0", max: "0", value: "0", id: "scrub" });
    const at = h("output", { class: "figure", for: "scrub" });
    const live = h("button", { type: "button", onclick: () => choose(null) }, "Newest");
    const revert = h("button", { type: "button", class: "danger", disabled: true, onclick: () => goBack() }, "Revert to here …");
    const axis = h("select", { id: "axis" }, h("option", { value: "seq" }, "seq"), h("option", { value: "move" }, "move"), h("option", { value: "time" }, "machine time"));
    axis.addEventListener("change", () => plots.show(axis.value as Axis));
    slider.addEventListener("input", () => {
        const row = Number(slider.value);
        choose(row >= history.seq.length - 1 ? null : (history.seq[row] ?? null));
    });

    let asked = new AbortController();
    /** Shows the totals at a seq of the past; at null the newest, as they change. */
    function choose(seq: number | null): void {
        chosen = seq !== null && seq === newest?.seq ? null : seq;
        asked.abort();
        asked = new AbortController();
        plots.mark(chosen);
        draw();
        if (chosen === null) return;
        const wanted = chosen;
        const stop = asked.signal;
        void (async () => {
            await pause(40, stop);
            if (stop.aborted) return;
            try {
                const totals = await json<Totals>(`${scenePath(scene.name)}/mass-properties?at=${wanted}`, { signal: stop });
                if (!stop.aborted) showTotals(place, scene, totals);
            } catch (error) {
                if (!stop.aborted) replace(place, h("p", { class: "wrong", role: "alert" }, (error as Error).message));
            }
        })();
    }

    function draw(): void {
        if (newest && chosen === null) showTotals(place, scene, newest);
        const last = history.seq.length - 1;
        slider.max = String(Math.max(0, last));
        slider.value = String(chosen === null ? Math.max(0, last) : history.seq.indexOf(chosen));
        const shown = chosen ?? newest?.seq ?? 0;
        at.textContent = chosen === null ? `seq ${count(shown)}, the newest` : `seq ${count(shown)} of ${count(newest?.seq ?? 0)}`;
        slider.setAttribute("aria-valuetext", at.textContent);
        live.disabled = chosen === null;
        revert.disabled = chosen === null;
        past.hidden = history.seq.length === 0;
    }

    async function goBack(): Promise<void> {
        const to = chosen;
        if (to === null) return;
        const text = `${scene.name} becomes what it was at seq ${count(to)}, as one new change. Nothing of the history is lost.`;
        if (!(await confirmed(`Revert to seq ${count(to)}?`, text, "Revert"))) return;
        try {
            await send("POST", `${scenePath(scene.name)}/revert`, { to });
            choose(null);
        } catch (error) {
            trouble((error as Error).message);
        }
    }

    async function remove(): Promise<void> {
        const text = `The scene ${scene.name} and all its data go. This cannot be taken back.`;
        if (!(await confirmed(`Delete ${scene.name}?`, text, `Delete ${scene.name}`))) return;
        try {
            await ask(scenePath(scene.name), { method: "DELETE" });
            go("/");
        } catch (error) {
            trouble((error as Error).message);
        }
    }

    const past = h("section", { class: "card past", "aria-labelledby": "past-title" },
        h("div", { class: "row" }, h("h2", { id: "past-title" }, "History"), plots.summary, h("span", { class: "grow" }),
            h("label", { for: "axis" }, "over "), axis),
        plots.element,
        h("div", { class: "row scrub" }, h("label", { for: "scrub" }, "Go through it"), slider, at, live, revert));
    const downloads = saving(scene);
    view.meshes = (there) => (downloads.hidden = !there);
    const kind = scene.solids === undefined ? `cubes, edge ${scene.edge} ${scene.unit}` : "solids";
    replace(main,
        h("div", { class: "row title" }, h("h1", {}, scene.name), state, h("span", { class: "note" }, kind)),
        h("div", { class: "columns" }, view.element,
            h("section", { class: "card", "aria-labelledby": "totals-title" }, h("h2", { id: "totals-title" }, "Mass properties"), place)),
        past,
        h("div", { class: "columns three" }, drop(scene), downloads,
            h("section", { class: "card", "aria-labelledby": "danger-title" }, h("h2", { id: "danger-title" }, "This scene"),
                h("dl", { class: "settings" }, settings(scene).flatMap(([term, value]) => [h("dt", {}, term), h("dd", {}, value)])),
                h("div", { class: "row end" }, h("button", { type: "button", class: "danger", onclick: remove }, "Delete the scene …")))));
    draw();

    let growing = false;
    async function grow(): Promise<void> {
        if (growing) return;
        growing = true;
        try {
            while (newest && !signal.aborted && (history.seq.at(-1) ?? 0) < newest.seq) {
                if (!(await history.grow(scene.name, newest.seq, signal))) break;
                plots.update();
                draw();
                await pause(HISTORY_MS, signal);
            }
        } catch {
            // The stream tells that the server is gone, and asks for the history again when it is back.
        } finally {
            growing = false;
        }
    }

    let waiting = 0;
    void (async () => {
        for (let wait: number = AGAIN_MS[0]; !signal.aborted; wait = Math.min(AGAIN_MS[1], wait * 2)) {
            try {
                for await (const text of events(`${scenePath(scene.name)}/mass-properties/stream`, signal)) {
                    newest = JSON.parse(text) as Totals;
                    wait = AGAIN_MS[0];
                    state.className = "state running";
                    state.textContent = "live";
                    trouble("");
                    // Many states in one frame of the screen are drawn once.
                    cancelAnimationFrame(waiting);
                    waiting = requestAnimationFrame(() => {
                        draw();
                        if (newest) view.update(newest);
                    });
                    void grow();
                }
                if (signal.aborted) return;
                const found = await json<Scene>(scenePath(scene.name), { signal });
                // The same name may stand for another scene by now.
                if (found.incarnation !== scene.incarnation) return location.reload();
            } catch (error) {
                if (signal.aborted) return;
                if (error instanceof Refused && error.status === 404) {
                    replace(main, h("h1", {}, "The scene is gone"), h("p", {}, `Somebody has deleted ${scene.name}. `, h("a", { href: "/" }, "All scenes")));
                    return;
                }
                trouble(`${(error as Error).message}. What is shown is what it said last; it is asked again.`);
                state.className = "state stopped";
                state.textContent = "not connected";
            }
            await pause(wait, signal);
        }
    })();
}

function settings(scene: Scene): [string, string][] {
    const stock = scene.stock as { min?: number[]; max?: number[] } | null | undefined;
    const rows: [string, string][] = [
        ["Kind", scene.solids === undefined ? "cubes" : "solids"],
        ["Unit", scene.unit ?? "–"],
        ["Steps per unit", scene.steps_per_unit === undefined ? "–" : count(scene.steps_per_unit)],
        ["Density", String(scene.density ?? "–")],
        ["Stock", stock ? (stock.min ? `${stock.min.join(", ")} to ${stock.max?.join(", ")}` : Object.keys(stock)[0]!) : "none"],
    ];
    if (scene.shapes) rows.push(["Shapes", Object.keys(scene.shapes).join(", ") || "none"]);
    return rows;
}

/** Meshes to download. They are asked for with the key, which a link cannot send. */
function saving(scene: Scene): HTMLElement {
    const parts = scene.stock ? ["remaining", "removed", "union"] : ["union"];
    const part = h("select", { id: "save-part" }, parts.map((name) => h("option", {}, name)));
    const said = h("div", { role: "status", class: "said" });
    const save = async (format: string): Promise<void> => {
        replace(said, `Asking for ${format.toUpperCase()} …`);
        try {
            const answer = await ask(`${scenePath(scene.name)}/mesh?part=${part.value}&format=${format}`);
            const link = h("a", { href: URL.createObjectURL(await answer.blob()), download: `${scene.name}-${part.value}.${format}` });
            document.body.append(link);
            link.click();
            link.remove();
            setTimeout(() => URL.revokeObjectURL(link.href), 60_000);
            replace(said, `${link.download} is saved.`);
        } catch (error) {
            const lines = error instanceof Refused ? error.lines() : [(error as Error).message];
            replace(said, lines.map((line) => h("p", { class: "wrong" }, line)));
        }
    };
    return h("section", { class: "card", "aria-labelledby": "save-title" }, h("h2", { id: "save-title" }, "Meshes"),
        h("div", { class: "field" }, h("label", { for: "save-part" }, "Part"), part),
        h("div", { class: "row formats" }, ["stl", "ply", "obj", "3mf", "glb"].map((format) =>
            h("button", { type: "button", onclick: () => save(format) }, format.toUpperCase()))), said);
}
