/** The picture: the boundary in three dimensions, with its controls. */

import type { Box, Refused, Scene, Totals } from "./api";
import { h, replace } from "./dom";
import { count, number } from "./format";
import { Renderer } from "./renderer";
import { type Part, Tiles } from "./tiles";

export class View3d {
    readonly element: HTMLElement;
    /** Called when it is known whether the server has meshes of this scene. */
    meshes: (there: boolean) => void = () => {};
    private readonly status = h("span", { class: "note", role: "status" });
    private readonly size = h("span", { class: "note figure" });
    private renderer: Renderer | null = null;
    private tiles: Tiles | null = null;
    private box: Box | null = null;
    private readonly place = h("input", { type: "range", min: 0, max: 1000, value: "500", "aria-label": "Where the slice plane is", hidden: true });
    private readonly said = h("output", { class: "figure" });
    private readonly axis = h("select", { "aria-label": "Slice plane" },
        ["no slice", "x", "y", "z"].map((name, index) => h("option", { value: String(index - 1) }, index === 0 ? name : `slice ${name}`)));

    constructor(private readonly scene: Scene, part: Part, signal: AbortSignal) {
        const canvas = h("canvas", {
            class: "picture", tabindex: "0", role: "img",
            "aria-label": `${scene.name} in three dimensions. Arrow keys turn it, with shift they move it, plus and minus zoom, Home looks at all of it.`,
        });
        const parts: Part[] = scene.stock ? ["remaining", "removed", "union"] : ["union"];
        const names = { remaining: "What remains", removed: "What is removed", union: "The union itself" };
        const choice = h("select", { "aria-label": "Part" }, parts.map((name) => h("option", { value: name, selected: name === part }, names[name])));
        choice.addEventListener("change", () => this.tiles?.show(choice.value as Part));
        try {
            this.renderer = new Renderer(canvas, signal);
            this.tiles = new Tiles(scene.name, scene.steps_per_unit ?? 1, part, this.renderer, (text, refused) => this.tell(text, refused), signal);
        } catch (error) {
            this.status.textContent = `No picture: ${(error as Error).message}.`;
        }
        const look = (from: "iso" | "front" | "top" | "right"): HTMLElement =>
            h("button", { type: "button", onclick: () => this.renderer?.look(from) }, from[0]!.toUpperCase() + from.slice(1));
        this.axis.addEventListener("change", () => this.slice());
        this.place.addEventListener("input", () => this.slice());
        this.element = h("section", { class: "card view", "aria-label": "Picture" },
            h("div", { class: "row tools" }, parts.length > 1 ? choice : null, h("div", { class: "group", role: "group", "aria-label": "Look from" },
                (["iso", "front", "top", "right"] as const).map(look)), h("span", { class: "grow" }), this.axis, this.place, this.said),
            h("div", { class: "stage" }, canvas, h("div", { class: "under" }, this.status, h("span", { class: "grow" }), this.size)));
        // Tests ask how many frames were drawn of how many triangles.
        Object.assign(canvas, { renderer: this.renderer });
    }

    update(totals: Totals): void {
        const box = boundsOf(this.scene.stock, totals);
        if (box && JSON.stringify(box) !== JSON.stringify(this.box)) {
            const grown = !this.box || diagonal(box) > 1.5 * diagonal(this.box);
            this.box = box;
            this.renderer?.frame(box, grown);
            this.slice();
        }
        if (!box) this.status.textContent = "There is nothing in the scene yet.";
        this.tiles?.update(totals, box);
    }

    private tell(text: string, refused: Refused | null): void {
        const none = refused?.code === "no-such-path" || refused?.status === 405;
        this.status.textContent = none ? "This server makes no meshes: only the bounds are drawn." : text;
        this.meshes(!none);
        const triangles = this.renderer?.triangles ?? 0;
        this.size.textContent = triangles ? `${count(triangles)} triangles` : "";
    }

    private slice(): void {
        const axis = Number(this.axis.value);
        this.place.hidden = axis < 0;
        replace(this.said);
        if (!this.renderer) return;
        this.renderer.cut = null;
        if (axis >= 0 && this.box) {
            const [low, high] = [this.box.min[axis]!, this.box.max[axis]!];
            const at = low + ((high - low) * Number(this.place.value)) / 1000;
            this.renderer.cut = { axis: axis as 0 | 1 | 2, at };
            const shown = Number(at.toPrecision(4));
            replace(this.said, `${"xyz"[axis]} ${number(shown)} ${this.scene.unit ?? ""}`);
            this.place.setAttribute("aria-valuetext", `${number(shown)} ${this.scene.unit ?? ""}`);
        }
        this.renderer.draw();
    }
}

const diagonal = (box: Box): number => Math.hypot(...box.max.map((high, axis) => high - box.min[axis]!));

/** The box of a stock, however it was given; of a scene without one that of the union. */
export function boundsOf(stock: unknown, totals: Totals): Box | null {
    const given = stock as { min?: Box["min"]; max?: Box["max"]; hull?: number[][]; cylinder?: { diameter: number; length: number; at?: number[] } } | null;
    if (given?.min && given.max) return { min: given.min, max: given.max };
    const points = given?.hull;
    if (points?.length) {
        const of = (pick: (...values: number[]) => number): Box["min"] => [0, 1, 2].map((axis) => pick(...points.map((point) => point[axis]!))) as Box["min"];
        return { min: of(Math.min), max: of(Math.max) };
    }
    if (given?.cylinder) {
        const { diameter, length, at = [0, 0, 0] } = given.cylinder;
        const [x = 0, y = 0, z = 0] = at;
        return { min: [x - diameter / 2, y - diameter / 2, z], max: [x + diameter / 2, y + diameter / 2, z + length] };
    }
    return totals.bounds ?? null;
}
