/** The server's API: with a key where one is needed, and what goes wrong in words. */

import { h } from "./dom";

export interface Fault {
    pointer?: string;
    parameter?: string;
    detail: string;
    value?: unknown;
}

/** A refusal of the server: RFC 9457. */
export class Refused extends Error {
    constructor(
        readonly status: number,
        readonly code: string,
        readonly title: string,
        detail: string,
        readonly errors: Fault[],
    ) {
        super(detail || title);
    }

    /** All that is wrong, with its place and value, a fault a line. */
    lines(): string[] {
        if (this.errors.length === 0) return [this.message];
        return this.errors.map((fault) => {
            const place = fault.pointer ?? fault.parameter ?? "";
            const value = fault.value === undefined ? "" : ` (${JSON.stringify(fault.value)})`;
            return `${place || "the body"} ${fault.detail}${value}`;
        });
    }
}

/** The server cannot be reached. */
export class Unreachable extends Error {
    constructor() {
        super("the server does not answer");
    }
}

export type Vector = [number, number, number];
export interface Box {
    min: Vector;
    max: Vector;
}

export interface Scene {
    name: string;
    kind?: string;
    edge?: number;
    unit?: string;
    density?: number;
    steps_per_unit?: number;
    stock?: unknown;
    shapes?: Record<string, unknown>;
    cubes?: number | null;
    solids?: number | null;
    seq: number | null;
    incarnation: string;
    state: "running" | "recovering" | "stopped" | "damaged";
    percent?: number;
    cause?: string;
}

export interface Measures {
    volume: number;
    area?: number;
    edge_length?: { total: number; convex: number; concave: number; crossing: number };
    mass?: number;
    mean_curvature?: number;
    centroid?: Vector | null;
    inertia?: Vector[] | null;
    bounds?: Box | null;
    euler_characteristic?: number;
    vertices?: Record<string, number>;
}

export interface Totals extends Measures {
    scene: string;
    seq: number;
    cubes?: number;
    solids?: number;
    removed?: Measures | null;
    remaining?: Measures | null;
}

const KEY = "union3d-key";
let asking: Promise<void> | null = null;

function headers(more?: HeadersInit): Headers {
    const all = new Headers(more);
    const key = sessionStorage.getItem(KEY);
    if (key) all.set("authorization", `Bearer ${key}`);
    return all;
}

/** Whether a key is kept: for this tab, until it is closed. */
export const hasKey = (): boolean => sessionStorage.getItem(KEY) !== null;

export function forgetKey(): void {
    sessionStorage.removeItem(KEY);
    location.reload();
}

function askForKey(again: boolean): Promise<void> {
    asking ??= new Promise<void>((resolve) => {
        const input = h("input", { type: "password", autocomplete: "off", spellcheck: "false", required: true, id: "key" });
        const form = h(
            "form",
            {},
            h("h2", { id: "key-title" }, "A key, please"),
            h("p", {}, "This server answers those who have a key. It is kept for this tab until you close it."),
            again ? h("p", { class: "wrong", role: "alert" }, "The server does not know the key that was given.") : null,
            h("div", { class: "field" }, h("label", { for: "key" }, "Key"), input),
            h("div", { class: "row end" }, h("button", { class: "primary" }, "Use this key")),
        );
        const dialog = h("dialog", { "aria-labelledby": "key-title" }, form);
        // Without a key there is nothing to see: the question stays.
        dialog.addEventListener("cancel", (event) => event.preventDefault());
        form.addEventListener("submit", (event) => {
            event.preventDefault();
            sessionStorage.setItem(KEY, input.value.trim());
            dialog.remove();
            asking = null;
            resolve();
        });
        document.body.append(dialog);
        dialog.showModal();
    });
    return asking;
}

/** Asks the server. A refusal is thrown as {@link Refused}; when a key is needed, the user is asked and the call sent again. */
export async function ask(path: string, options: RequestInit = {}): Promise<Response> {
    for (;;) {
        if (asking) await asking;
        const sent = headers(options.headers);
        let answer: Response;
        try {
            answer = await fetch(path, { ...options, headers: sent });
        } catch (error) {
            if (options.signal?.aborted) throw error;
            throw new Unreachable();
        }
        if (answer.ok || answer.status === 304) return answer;
        const problem = await problemOf(answer);
        if (answer.status !== 401) throw problem;
        const same = headers().get("authorization") === sent.get("authorization");
        if (same) await askForKey(sent.has("authorization"));
        if (options.signal?.aborted) throw problem;
    }
}

async function problemOf(answer: Response): Promise<Refused> {
    const text = await answer.text().catch(() => "");
    try {
        const read = JSON.parse(text);
        const code = String(read.type ?? "").split("/").pop() ?? "";
        return new Refused(answer.status, code, read.title ?? "", read.detail ?? "", read.errors ?? []);
    } catch {
        return new Refused(answer.status, "", `the server answered ${answer.status}`, "", []);
    }
}

export const scenePath = (name: string): string => `/v1/scenes/${encodeURIComponent(name)}`;

export async function json<T>(path: string, options: RequestInit = {}): Promise<T> {
    const answer = await ask(path, { ...options, headers: { accept: "application/json", ...(options.headers as Record<string, string>) } });
    return (await answer.json()) as T;
}

export const send = (method: string, path: string, body: unknown): Promise<Response> =>
    ask(path, { method, headers: { "content-type": "application/json" }, body: JSON.stringify(body) });

/** Server-sent events over `fetch`, which can send a key: the data of each, until the stream ends. */
export async function* events(path: string, signal: AbortSignal): AsyncGenerator<string> {
    const answer = await ask(path, { signal, headers: { accept: "text/event-stream" } });
    if (!answer.body) return;
    const reader = answer.body.pipeThrough(new TextDecoderStream()).getReader();
    let rest = "";
    try {
        for (;;) {
            const { value, done } = await reader.read();
            if (done) return;
            rest += value;
            const blocks = rest.split("\n\n");
            rest = blocks.pop() ?? "";
            for (const block of blocks) {
                const lines = block.split("\n").filter((line) => line.startsWith("data:"));
                if (lines.length) yield lines.map((line) => line.slice(5).trimStart()).join("\n");
            }
        }
    } finally {
        reader.cancel().catch(() => {});
    }
}

export const pause = (ms: number, signal?: AbortSignal): Promise<void> =>
    new Promise((resolve) => {
        const timer = setTimeout(resolve, ms);
        signal?.addEventListener("abort", () => (clearTimeout(timer), resolve()), { once: true });
    });
