/** The boundary of a scene in tiles of space, each asked for anew when the scene has changed. */

import { type Box, type Totals, type Vector, Refused, ask, pause, scenePath } from "./api";
import { readStl } from "./stl";
import type { Renderer } from "./renderer";

/** Least time between two rounds. */
const ROUND_MS = 1000;
/** Requests at a time. */
const AT_ONCE = 2;
/** A scene with fewer bodies is one tile. */
const ONE_TILE_BODIES = 300;

interface Tile {
    name: string;
    box: Box;
    /** The seq that it was asked for at; -1 when it never was. */
    seq: number;
}

export type Part = "remaining" | "union" | "removed";

export class Tiles {
    private tiles: Tile[] = [];
    private size = 0;
    private totals: Totals | null = null;
    private before: Totals | null = null;
    private box: Box | null = null;
    private part: Part;
    private ended = new AbortController();
    private busy = false;

    constructor(
        private readonly scene: string,
        private readonly steps: number,
        part: Part,
        private readonly renderer: Renderer,
        private readonly tell: (text: string, refused: Refused | null) => void,
        private readonly signal: AbortSignal,
    ) {
        this.part = part;
        signal.addEventListener("abort", () => this.ended.abort());
    }

    show(part: Part): void {
        this.part = part;
        this.again();
    }

    /** Forgets all tiles and asks for them anew. */
    again(): void {
        this.ended.abort();
        this.ended = new AbortController();
        this.tiles = [];
        this.size = 0;
        this.before = null;
        this.renderer.clear();
        if (this.totals) this.update(this.totals, this.box);
    }

    /** Takes up newer totals, and the box that the part lies in. */
    update(totals: Totals, box: Box | null): void {
        this.totals = totals;
        this.box = box;
        this.lay();
        void this.run();
    }

    /** Lays tiles over the box: cubes of space whose size is a power of two, so that they stay when the box grows a little. */
    private lay(): void {
        const { box, totals } = this;
        if (!box || !totals) return;
        const longest = Math.max(...box.max.map((high, axis) => high - box.min[axis]!));
        if (!(longest > 0)) return;
        const few = (totals.solids ?? totals.cubes ?? 0) <= ONE_TILE_BODIES;
        const size = few ? Infinity : 2 ** Math.ceil(Math.log2((longest * this.steps) / 6)) / this.steps;
        if (size !== this.size) {
            this.size = size;
            this.tiles = [];
            this.renderer.clear();
        }
        const known = new Map(this.tiles.map((tile) => [tile.name, tile]));
        const ranges = box.min.map((low, axis) => (few ? [0, 0] : [Math.floor(low / size), Math.ceil(box.max[axis]! / size) - 1])) as [number, number][];
        const tiles: Tile[] = [];
        for (let x = ranges[0]![0]; x <= ranges[0]![1]; x += 1)
            for (let y = ranges[1]![0]; y <= ranges[1]![1]; y += 1)
                for (let z = ranges[2]![0]; z <= ranges[2]![1]; z += 1) {
                    const name = `${x},${y},${z}`;
                    const at = [x, y, z] as Vector;
                    // Tiles end a step before the next one: so every face is in one of them.
                    const whole = { min: at.map((index) => index * size) as Vector, max: at.map((index) => (index + 1) * size - 1 / this.steps) as Vector };
                    tiles.push(known.get(name) ?? { name, box: few ? box : whole, seq: -1 });
                }
        for (const tile of this.tiles) if (!tiles.includes(tile)) this.renderer.remove(tile.name);
        this.tiles = tiles;
    }

    private async run(): Promise<void> {
        if (this.busy) return;
        this.busy = true;
        try {
            while (!this.signal.aborted && this.totals) {
                const { totals, ended } = this;
                const stale = this.tiles.filter((tile) => tile.seq < totals.seq);
                if (stale.length === 0) break;
                const begun = performance.now();
                const place = changedAt(this.before, totals);
                const far = (tile: Tile): number => (tile.seq < 0 ? 0 : place ? Math.hypot(...place.map((at, axis) =>
                    Math.max(tile.box.min[axis]! - at, 0, at - tile.box.max[axis]!))) : 0);
                stale.sort((one, other) => far(one) - far(other));
                this.before = totals;
                const fetched = await this.round(stale, totals, ended.signal);
                if (!fetched) break;
                await pause(Math.max(0, ROUND_MS - (performance.now() - begun)), this.signal);
            }
        } finally {
            this.busy = false;
        }
    }

    /** Asks for these tiles; says whether to go on. */
    private async round(stale: Tile[], totals: Totals, signal: AbortSignal): Promise<boolean> {
        const queue = [...stale];
        let left = queue.length;
        const worker = async (): Promise<void> => {
            for (let tile = queue.shift(); tile && !signal.aborted; tile = queue.shift()) {
                const box = this.size === Infinity ? "" : `&box=${[...tile.box.min, ...tile.box.max].map((value) => Number(value.toFixed(9))).join(",")}`;
                const answer = await ask(`${scenePath(this.scene)}/mesh?part=${this.part}&format=stl${box}`, { signal });
                const mesh = readStl(await answer.arrayBuffer());
                if (signal.aborted) return;
                this.renderer.set(tile.name, mesh);
                // The seq that it is of, which may be newer than what was asked for: the entity tag ends with it.
                tile.seq = Number(/-(\d+)"$/.exec(answer.headers.get("etag") ?? "")?.[1] ?? totals.seq);
                left -= 1;
                this.tell(left > 0 && stale.length > 1 ? `${left} of ${this.tiles.length} tiles to come` : "", null);
            }
        };
        try {
            await Promise.all(Array.from({ length: AT_ONCE }, worker));
            return true;
        } catch (error) {
            // What was begun anew has ended the older round.
            if (signal.aborted) return !this.signal.aborted;
            this.tell((error as Error).message, error instanceof Refused ? error : null);
            return false;
        }
    }
}

/** Where between two totals material came or went: from the difference of their first moments. */
function changedAt(before: Totals | null, after: Totals): Vector | null {
    const volume = after.volume - (before?.volume ?? 0);
    if (!before?.centroid || !after.centroid || Math.abs(volume) < 1e-9 * Math.abs(after.volume)) return null;
    return after.centroid.map((at, axis) => (at * after.volume - before.centroid![axis]! * before.volume) / volume) as Vector;
}
