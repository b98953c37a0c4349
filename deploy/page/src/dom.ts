/** Elements, made by calls: `h("p", { class: "note" }, "text")`. Text is always text, never markup. */

type Child = Node | string | number | null | undefined | false;
type Attributes = Record<string, unknown>;

export function h<K extends keyof HTMLElementTagNameMap>(
    tag: K,
    attributes: Attributes = {},
    ...children: (Child | Child[])[]
): HTMLElementTagNameMap[K] {
    const element = document.createElement(tag);
    for (const [name, value] of Object.entries(attributes)) {
        if (value === undefined || value === null || value === false) continue;
        if (typeof value === "function") element.addEventListener(name.replace(/^on/, ""), value as EventListener);
        else if (name in element && typeof value !== "string") (element as unknown as Attributes)[name] = value;
        else element.setAttribute(name, value === true ? "" : String(value));
    }
    fill(element, children);
    return element;
}

function fill(element: Element, children: (Child | Child[])[]): void {
    for (const child of children.flat()) {
        if (child === null || child === undefined || child === false) continue;
        element.append(child instanceof Node ? child : String(child));
    }
}

/** Puts these in place of what is in the element. */
export function replace(element: Element, ...children: (Child | Child[])[]): void {
    element.replaceChildren();
    fill(element, children);
}

/** A label over its control, with a place for what is wrong with it. */
export function field(label: string, control: HTMLElement, hint = ""): HTMLElement {
    const wrong = h("span", { class: "wrong", hidden: true });
    control.id ||= `f${++counted}`;
    wrong.id = `${control.id}-wrong`;
    control.setAttribute("aria-describedby", wrong.id);
    return h("div", { class: "field" }, h("label", { for: control.id }, label, hint ? h("small", {}, ` ${hint}`) : null), control, wrong);
}

let counted = 0;

/** Shows what is wrong with a control, or that nothing is. */
export function mark(control: HTMLElement, text: string): void {
    const wrong = document.getElementById(`${control.id}-wrong`);
    if (!wrong) return;
    wrong.textContent = text;
    wrong.hidden = text === "";
    if (text) control.setAttribute("aria-invalid", "true");
    else control.removeAttribute("aria-invalid");
}

/** Asks before something that cannot be taken back. */
export function confirmed(title: string, text: string, action: string, dangerous = true): Promise<boolean> {
    return new Promise((resolve) => {
        const heading = h("h2", { id: "ask-title" }, title);
        const dialog = h(
            "dialog",
            { "aria-labelledby": "ask-title" },
            heading,
            h("p", {}, text),
            h(
                "div",
                { class: "row end" },
                h("button", { type: "button", onclick: () => dialog.close("") }, "Cancel"),
                h("button", { type: "button", class: dangerous ? "danger" : "primary", onclick: () => dialog.close("yes") }, action),
            ),
        );
        dialog.addEventListener("close", () => {
            dialog.remove();
            resolve(dialog.returnValue === "yes");
        });
        document.body.append(dialog);
        dialog.showModal();
    });
}
