/** The table of mass properties. */

import type { Box, Measures, Scene, Totals, Vector } from "./api";
import { h, replace } from "./dom";
import { count, counted, number, unitTo } from "./format";

export function showTotals(place: HTMLElement, scene: Scene, totals: Totals): void {
    const unit = scene.unit ?? "";
    const { removed, remaining } = totals;
    const columns: [string, Measures][] = remaining
        ? [["Remaining", remaining], ["Removed", removed && Object.keys(removed).length > 1 ? removed : { ...totals, ...removed }]]
        : [["Union", totals]];
    const rows: Row[] = [
        ["Volume", unitTo(unit, 3), (m) => one(m.volume)],
        ["Area", unitTo(unit, 2), (m) => one(m.area)],
        ["Edge length", unit, (m) => one(m.edge_length?.total)],
        ["convex", unit, (m) => one(m.edge_length?.convex)],
        ["concave", unit, (m) => one(m.edge_length?.concave)],
        ["crossing", unit, (m) => one(m.edge_length?.crossing)],
        ["Mass", "", (m) => one(m.mass)],
        ["Centroid", unit, (m) => vector(m.centroid)],
        ...([["Inertia xx", 0, 0], ["yy", 1, 1], ["zz", 2, 2], ["xy", 0, 1], ["xz", 0, 2], ["yz", 1, 2]] as const).map(([name, row, column]) =>
            [name, unitTo(unit, 5), (m: Measures) => one(m.inertia?.[row]?.[column])] as Row),
        ["Bounds", unit, (m) => box(m.bounds)],
        ["Mean curvature", unit, (m) => one(m.mean_curvature)],
        ["Euler characteristic", "", (m) => one(m.euler_characteristic)],
        ["Vertices", "", (m) => one(m.vertices?.["total"])],
    ];
    const minor = new Set(["convex", "concave", "crossing", "yy", "zz", "xy", "xz", "yz"]);
    const shown = rows.filter(([, , value]) => columns.some(([, measures]) => value(measures)));
    const bodies = totals.solids ?? totals.cubes ?? 0;
    replace(place,
        h("table", { class: "totals" },
            h("caption", {}, `${counted(bodies, totals.solids === undefined ? "cube" : "solid")} at seq ${count(totals.seq)}`),
            columns.length > 1 ? h("thead", {}, h("tr", {}, h("td", {}), columns.map(([title]) => h("th", { scope: "col", class: "figure" }, title)), h("td", {}))) : null,
            h("tbody", {}, shown.map(([name, power, value]) => h("tr", { class: minor.has(name) ? "minor" : "" },
                h("th", { scope: "row" }, name),
                columns.map(([, measures]) => h("td", { class: "figure" }, (value(measures) ?? ["–"]).map((line) => h("span", { class: "line" }, line)))),
                h("td", { class: "unit" }, power))))));
}

type Row = [string, string, (measures: Measures) => string[] | undefined];

const one = (value: number | undefined | null): string[] | undefined => (value === undefined || value === null ? undefined : [number(value)]);
const vector = (value: Vector | null | undefined): string[] | undefined => value?.map(number);
const box = (value: Box | null | undefined): string[] | undefined =>
    value ? value.min.map((low, axis) => `${number(low)} … ${number(value.max[axis]!)}`) : undefined;
