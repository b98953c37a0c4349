/** What the types of problems mean. */

import { json } from "./api";
import { h, replace } from "./dom";
import { trouble, type View } from "./main";

interface Kind {
    code: string;
    status: number;
    title: string;
    meaning: string;
    retry_after_seconds: number | null;
}

export const problem =
    (code: string): View =>
    async (main, crumbs, signal) => {
        document.title = code ? `${code} · union3d` : "Problems · union3d";
        replace(crumbs, h("a", { href: "/problems" }, "Problems"), code ? ` / ${code}` : null);
        try {
            const kinds = code
                ? [await json<Kind>(`/problems/${encodeURIComponent(code)}`, { signal })]
                : (await json<{ problems: Kind[] }>("/problems", { signal })).problems;
            if (signal.aborted) return;
            replace(main, code ? null : h("h1", {}, "What can go wrong"), kinds.map((kind) => shown(kind, code !== "")));
        } catch (error) {
            if (signal.aborted) return;
            replace(main, h("h1", {}, "There is nothing here"), h("p", {}, (error as Error).message));
            trouble("");
        }
    };

function shown(kind: Kind, alone: boolean): HTMLElement {
    const title = `${kind.title}`;
    return h(
        "section",
        { class: "card problem" },
        h(alone ? "h1" : "h2", {}, alone ? title : h("a", { href: `/problems/${kind.code}` }, title)),
        h("p", { class: "note" }, h("code", {}, kind.code), ` · status ${kind.status}`,
            kind.retry_after_seconds === null ? "" : ` · again after ${kind.retry_after_seconds} s`),
        h("p", {}, kind.meaning),
    );
}
