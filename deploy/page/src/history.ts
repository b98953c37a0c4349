/** The history of a scene in columns, as it grows. */

import { ask, scenePath } from "./api";

/** Most changes that are drawn: of a longer history the newest. */
export const ROWS_MAX = 200_000;

export class History {
    seq: number[] = [];
    move: (number | null)[] = [];
    /** Machine time since the first change that is here, in seconds. */
    time: number[] = [];
    volume: number[] = [];
    area: (number | null)[] = [];
    removed: number[] = [];
    rate: (number | null)[] = [];
    /** Changes that inserted something and removed nothing. */
    air: boolean[] = [];
    /** Whether older changes are left out. */
    cut = false;

    /** Asks for what is not here yet, up to a seq; says whether something came. */
    async grow(scene: string, newest: number, signal: AbortSignal): Promise<boolean> {
        const last = this.seq.at(-1) ?? 0;
        const from = Math.max(last + 1, newest - ROWS_MAX + 1);
        if (from > newest) return false;
        if (last === 0 && from > 1) this.cut = true;
        const answer = await ask(`${scenePath(scene)}/history?from=${from}&to=${newest}`, { signal, headers: { accept: "text/csv" } });
        const [header = "", ...lines] = (await answer.text()).trimEnd().split(/\r?\n/);
        const columns = header.split(",");
        const column = (name: string): number => columns.indexOf(name);
        const at = {
            seq: column("seq"), move: column("move"), duration: column("duration"), inserted: column("inserted"), area: column("area"),
            removed: column("volume_removed"), exact: column("volume_removed_exact"), rate: column("removal_rate"),
            volume: column("volume"), remaining: column("remaining"),
        };
        for (const line of lines) {
            const cells = line.split(",");
            const maybe = (index: number): number | null => (cells[index] ? Number(cells[index]) : null);
            this.seq.push(Number(cells[at.seq]));
            this.move.push(maybe(at.move));
            this.time.push((this.time.at(-1) ?? 0) + (maybe(at.duration) ?? 0));
            this.volume.push(maybe(at.remaining) ?? Number(cells[at.volume]));
            this.area.push(maybe(at.area));
            this.removed.push(Number(cells[at.removed]));
            this.rate.push(maybe(at.rate));
            this.air.push(Number(cells[at.inserted]) > 0 && cells[at.exact] === "0");
        }
        return lines.length > 0;
    }
}
