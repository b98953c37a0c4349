/** Plots of the history: volume, removal rate and area, over seq, move or machine time, with one cursor. */

import uPlot from "uplot";
import { h, replace } from "./dom";
import { brief, count, counted, seconds, unitTo } from "./format";
import type { History } from "./history";

export type Axis = "seq" | "move" | "time";

const HEIGHT = 150;

export class Plots {
    readonly element = h("div", { class: "plots" });
    readonly summary = h("p", { class: "note" });
    private plots: uPlot[] = [];
    private rows: number[] = [];
    private axis: Axis = "seq";
    private chosen: number | null = null;
    private readonly observer = new ResizeObserver(() => this.fit());

    constructor(
        private readonly history: History,
        private readonly unit: string,
        private readonly stock: boolean,
        private readonly choose: (seq: number) => void,
        signal: AbortSignal,
    ) {
        this.observer.observe(this.element);
        const scheme = matchMedia("(prefers-color-scheme: dark)");
        scheme.addEventListener("change", () => this.rebuild(), { signal });
        signal.addEventListener("abort", () => {
            this.observer.disconnect();
            this.plots.forEach((plot) => plot.destroy());
        });
    }

    show(axis: Axis): void {
        this.axis = axis;
        this.rebuild();
    }

    /** The seq that the cursor stands on; null when it is the newest. */
    mark(seq: number | null): void {
        this.chosen = seq;
        this.plots.forEach((plot) => plot.redraw(false));
    }

    private data(): uPlot.AlignedData[] {
        const { seq, move, time, volume, area, rate, air, removed } = this.history;
        const place = (row: number): number | null => (this.axis === "seq" ? seq[row]! : this.axis === "move" ? move[row]! : time[row]!);
        const rows = seq.map((_, row) => row).filter((row) => place(row) !== null);
        if (this.axis === "move") rows.sort((one, other) => move[one]! - move[other]! || one - other);
        this.rows = rows;
        const x = rows.map((row) => place(row)!);
        const of = (column: (number | null)[]): (number | null)[] => rows.map((row) => column[row] ?? null);
        const rates = rate.some((value) => value !== null) ? rate : removed;
        return [
            [x, of(volume)],
            [x, of(rates), rows.map((row) => (air[row] ? 0 : null))],
            [x, of(area)],
        ];
    }

    /** Takes up what the history has got. */
    update(): void {
        const { air, seq, cut, time } = this.history;
        const cuts = air.filter(Boolean).length;
        const total = time.at(-1) ?? 0;
        this.summary.textContent = seq.length === 0 ? "No changes yet." :
            `${cut ? "The newest " : ""}${counted(seq.length, "change")}, ${counted(cuts, "air cut")}${total ? `, ${seconds(total)} of machine time` : ""}`;
        if (this.plots.length === 0) return this.rebuild();
        const data = this.data();
        this.plots.forEach((plot, index) => plot.setData(data[index]!));
    }

    private rebuild(): void {
        this.plots.forEach((plot) => plot.destroy());
        this.plots = [];
        replace(this.element);
        if (this.history.seq.length === 0) return;
        const rated = this.history.rate.some((value) => value !== null);
        const grown = this.stock ? "removed" : "added";
        const titles = [
            `${this.stock ? "Remaining volume" : "Volume"}, ${unitTo(this.unit, 3)}`,
            rated ? `Removal rate, ${unitTo(this.unit, 3)}/s` : `Volume ${grown} by each change, ${unitTo(this.unit, 3)}`,
            `Area, ${unitTo(this.unit, 2)}`,
        ];
        const data = this.data();
        this.plots = titles.map((title, index) => this.plot(title, data[index]!, index));
    }

    private plot(title: string, data: uPlot.AlignedData, index: number): uPlot {
        const style = getComputedStyle(document.documentElement);
        const colour = (name: string): string => style.getPropertyValue(name).trim();
        const holder = h("figure", {}, h("figcaption", {}, title,
            index === 1 ? h("span", { class: "air-key" }, "air cut: nothing removed") : null));
        this.element.append(holder);
        const font = "12px system-ui, sans-serif";
        const axis = { stroke: colour("--soft"), grid: { stroke: colour("--line"), width: 1 }, ticks: { stroke: colour("--line"), width: 1 }, font };
        const label = { seq: "seq", move: "move", time: "machine time, s" }[this.axis];
        const line = colour(["--volume", "--rate", "--area"][index]!);
        const series: uPlot.Series[] = [
            { label, value: (_, value) => (value === null ? "–" : this.axis === "time" ? brief(value) : count(value)) },
            { label: title.split(",")[0]!, stroke: line, width: 1.5, fill: index === 0 ? `${line}22` : undefined, value: (_, value) => (value === null ? "–" : brief(value)),
                spanGaps: true, points: { show: data[0].length < 60, size: 5 }, paths: index === 1 ? undefined : uPlot.paths.stepped!({ align: 1 }) },
        ];
        if (index === 1) {
            series.push({ label: "air cut", stroke: colour("--air"), paths: () => null, points: { show: true, size: 6, fill: colour("--air") }, value: (_, value) => (value === null ? "no" : "yes") });
        }
        const options: uPlot.Options = {
            width: Math.max(200, this.element.clientWidth),
            height: HEIGHT + (index === 2 ? 18 : 0),
            series,
            scales: { x: { time: false }, y: { range: (_, low, high) => span(low, high) } },
            axes: [
                { ...axis, label: index === 2 ? label : undefined, labelFont: font, labelSize: 18, size: 26, values: (_, values) => values.map(brief) },
                { ...axis, size: 84, values: (_, values) => values.map(brief) },
            ],
            cursor: { sync: { key: "history" }, drag: { x: true, y: false } },
            legend: { live: true },
            hooks: {
                draw: [(plot) => this.line(plot, colour("--ink"))],
            },
        };
        const plot = new uPlot(options, data, holder);
        plot.over.addEventListener("click", () => {
            const row = this.rows[plot.cursor.idx ?? -1];
            if (row !== undefined) this.choose(this.history.seq[row]!);
        });
        return plot;
    }

    /** The upright line at the chosen seq. */
    private line(plot: uPlot, colour: string): void {
        if (this.chosen === null) return;
        const index = this.rows.findIndex((row) => this.history.seq[row] === this.chosen);
        if (index < 0) return;
        const x = Math.round(plot.valToPos(plot.data[0][index]!, "x", true)) + 0.5;
        const { ctx, bbox } = plot;
        ctx.save();
        ctx.strokeStyle = colour;
        ctx.lineWidth = devicePixelRatio;
        ctx.setLineDash([4 * devicePixelRatio, 3 * devicePixelRatio]);
        ctx.beginPath();
        ctx.moveTo(x, bbox.top);
        ctx.lineTo(x, bbox.top + bbox.height);
        ctx.stroke();
        ctx.restore();
    }

    private fit(): void {
        const width = Math.max(200, this.element.clientWidth);
        for (const plot of this.plots) if (plot.width !== width) plot.setSize({ width, height: plot.height });
    }
}

/** The least and greatest value with some room; a flat line lies in the middle. */
function span(low: number | null, high: number | null): [number, number] {
    if (low === null || high === null) return [0, 1];
    const room = (high - low || Math.abs(high) || 1) * 0.08;
    return [low >= 0 && low < room ? low - room / 2 : low - room, high + room];
}
