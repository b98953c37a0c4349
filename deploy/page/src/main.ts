/** The page: which view the address means, and what all views have around them. */

import "uplot/dist/uPlot.min.css";
import "./style.css";
import { forgetKey, hasKey } from "./api";
import { h, replace } from "./dom";
import { list } from "./list";
import { problem } from "./problem";
import { scene } from "./scene";

/** A view fills the page, and ends when the signal says so. */
export type View = (main: HTMLElement, crumbs: HTMLElement, signal: AbortSignal) => void;

const crumbs = h("span", { class: "crumbs" });
const main = h("main", { id: "main", tabindex: "-1" });
const key = h("button", { class: "quiet", hidden: true, onclick: forgetKey }, "Forget the key");
document.body.append(
    h("a", { class: "skip", href: "#main" }, "Skip to the content"),
    h(
        "header",
        { class: "top" },
        h("a", { class: "brand", href: "/" }, h("img", { src: "/assets/page.svg", alt: "", width: 24, height: 24 }), "union3d"),
        crumbs,
        h("span", { class: "grow" }),
        key,
        h("nav", { "aria-label": "More" }, h("a", { href: "/docs/" }, "API"), h("a", { href: "/problems" }, "Problems")),
    ),
    h("div", { id: "trouble", class: "trouble", role: "status", hidden: true }),
    main,
);

let ending = new AbortController();

function show(): void {
    ending.abort();
    ending = new AbortController();
    trouble("");
    replace(main);
    replace(crumbs);
    const [, first, second] = location.pathname.split("/");
    const name = decodeURIComponent(second ?? "");
    if (first === "scenes" && name) scene(name)(main, crumbs, ending.signal);
    else if (first === "problems") problem(name)(main, crumbs, ending.signal);
    else list(main, crumbs, ending.signal);
}

/** Says above everything what is wrong with the server; nothing when the text is empty. */
export function trouble(text: string): void {
    const place = document.getElementById("trouble");
    if (!place || place.textContent === text) return;
    place.textContent = text;
    place.hidden = text === "";
}

export function go(path: string): void {
    history.pushState(null, "", path);
    show();
    main.focus();
}

window.addEventListener("popstate", show);
document.addEventListener("click", (event) => {
    const link = (event.target as Element).closest?.("a");
    if (!link || event.defaultPrevented || event.ctrlKey || event.metaKey || event.shiftKey || link.hasAttribute("download")) return;
    if (link.origin !== location.origin || !/^\/(scenes\/|problems|$)/.test(link.pathname) || link.hash) return;
    event.preventDefault();
    go(link.pathname);
});
setInterval(() => (key.hidden = !hasKey()), 1000);
show();
