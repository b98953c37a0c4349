/** A small renderer of triangles over WebGL 2: one buffer for each tile, drawn when something has changed. */

import type { Box, Vector } from "./api";

/** Triangles as the renderer takes them: three corners after another, and the normal of each in bytes. */
export interface Mesh {
    triangles: number;
    positions: Float32Array;
    normals: Int8Array;
}

interface Tile {
    array: WebGLVertexArrayObject;
    buffers: WebGLBuffer[];
    count: number;
}

/** A half of space that is not drawn: what lies above `at` along the axis. */
export interface Cut {
    axis: 0 | 1 | 2;
    at: number;
}

const VERTEX = `#version 300 es
layout(location = 0) in vec3 place;
layout(location = 1) in vec3 normal;
uniform mat4 view;
uniform mat4 projection;
out vec3 seen;
out vec3 facing;
out vec3 there;
void main() {
    vec4 at = view * vec4(place, 1.0);
    seen = at.xyz;
    facing = mat3(view) * normal;
    there = place;
    gl_Position = projection * at;
}`;

const FRAGMENT = `#version 300 es
precision highp float;
in vec3 seen;
in vec3 facing;
in vec3 there;
uniform vec3 colour;
uniform vec3 inside;
uniform vec4 plane;
out vec4 shown;
void main() {
    if (dot(plane.xyz, there) > plane.w) discard;
    vec3 eye = normalize(-seen);
    vec3 n = normalize(facing);
    bool back = dot(n, eye) < 0.0;
    if (back) n = -n;
    float key = max(dot(n, normalize(vec3(-0.45, 0.75, 0.6))), 0.0);
    float fill = max(dot(n, normalize(vec3(0.8, -0.1, 0.35))), 0.0);
    float sky = 0.5 + 0.5 * n.y;
    vec3 light = vec3(0.34) + vec3(0.12, 0.14, 0.17) * sky + vec3(0.52, 0.5, 0.47) * key + vec3(0.10, 0.13, 0.18) * fill;
    float gleam = pow(max(dot(n, normalize(eye + normalize(vec3(-0.45, 0.75, 0.6)))), 0.0), 40.0) * 0.18;
    vec3 base = back ? inside : colour;
    shown = vec4(base * (back ? mix(light, vec3(0.9), 0.6) : light) + gleam, 1.0);
}`;

const LINE_VERTEX = `#version 300 es
layout(location = 0) in vec3 place;
uniform mat4 view;
uniform mat4 projection;
void main() { gl_Position = projection * view * vec4(place, 1.0); }`;

const LINE_FRAGMENT = `#version 300 es
precision mediump float;
uniform vec4 colour;
out vec4 shown;
void main() { shown = colour; }`;

export class Renderer {
    readonly canvas: HTMLCanvasElement;
    private readonly gl: WebGL2RenderingContext;
    private readonly program: WebGLProgram;
    private readonly lineProgram: WebGLProgram;
    private readonly lines: WebGLBuffer;
    private readonly lineArray: WebGLVertexArrayObject;
    private readonly places = new Map<WebGLProgram, Map<string, WebGLUniformLocation | null>>();
    private tiles = new Map<string, Tile>();
    private box: Box = { min: [0, 0, 0], max: [1, 1, 1] };
    private waiting = false;
    private azimuth = -0.9;
    private elevation = 0.6;
    private distance = 1;
    private target: Vector = [0.5, 0.5, 0.5];
    private ended = false;
    /** What is not drawn. */
    cut: Cut | null = null;
    /** Milliseconds that the last frames took, for the test of speed. */
    frames = 0;

    constructor(canvas: HTMLCanvasElement, signal: AbortSignal) {
        const gl = canvas.getContext("webgl2", { antialias: true, alpha: true, premultipliedAlpha: true });
        if (!gl) throw new Error("this browser has no WebGL 2");
        this.canvas = canvas;
        this.gl = gl;
        this.program = program(gl, VERTEX, FRAGMENT);
        this.lineProgram = program(gl, LINE_VERTEX, LINE_FRAGMENT);
        this.lines = gl.createBuffer();
        this.lineArray = gl.createVertexArray();
        gl.bindVertexArray(this.lineArray);
        gl.bindBuffer(gl.ARRAY_BUFFER, this.lines);
        gl.enableVertexAttribArray(0);
        gl.vertexAttribPointer(0, 3, gl.FLOAT, false, 0, 0);
        gl.bindVertexArray(null);
        this.control(signal);
        const observer = new ResizeObserver(() => this.draw());
        observer.observe(canvas);
        matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => this.draw(), { signal });
        signal.addEventListener("abort", () => {
            this.ended = true;
            observer.disconnect();
            gl.getExtension("WEBGL_lose_context")?.loseContext();
        });
    }

    get triangles(): number {
        let sum = 0;
        for (const tile of this.tiles.values()) sum += tile.count / 3;
        return sum;
    }

    /** Sets a tile in place of the one that was there. */
    set(name: string, mesh: Mesh): void {
        this.remove(name);
        if (mesh.triangles > 0 && !this.ended) {
            const { gl } = this;
            const array = gl.createVertexArray();
            gl.bindVertexArray(array);
            const buffers = [mesh.positions, mesh.normals].map((data, index) => {
                const buffer = gl.createBuffer();
                gl.bindBuffer(gl.ARRAY_BUFFER, buffer);
                gl.bufferData(gl.ARRAY_BUFFER, data, gl.STATIC_DRAW);
                gl.enableVertexAttribArray(index);
                gl.vertexAttribPointer(index, 3, index === 0 ? gl.FLOAT : gl.BYTE, index !== 0, index === 0 ? 0 : 4, 0);
                return buffer;
            });
            gl.bindVertexArray(null);
            this.tiles.set(name, { array, buffers, count: mesh.triangles * 3 });
        }
        this.draw();
    }

    remove(name: string): void {
        const tile = this.tiles.get(name);
        if (!tile) return;
        this.gl.deleteVertexArray(tile.array);
        tile.buffers.forEach((buffer) => this.gl.deleteBuffer(buffer));
        this.tiles.delete(name);
        this.draw();
    }

    clear(): void {
        [...this.tiles.keys()].forEach((name) => this.remove(name));
    }

    /** The box that is looked at, drawn in lines. */
    frame(box: Box, look: boolean): void {
        this.box = box;
        if (look) this.look("iso");
        this.draw();
    }

    look(from: "iso" | "front" | "top" | "right"): void {
        const size = Math.hypot(...this.box.max.map((high, axis) => high - this.box.min[axis]!)) || 1;
        this.target = this.box.min.map((low, axis) => (low + this.box.max[axis]!) / 2) as Vector;
        this.distance = size * 1.55;
        const angles = { iso: [-0.95, 0.6], front: [-Math.PI / 2, 0], top: [-Math.PI / 2, Math.PI / 2 - 1e-3], right: [0, 0] };
        [this.azimuth, this.elevation] = angles[from] as [number, number];
        this.draw();
    }

    turn(right: number, up: number): void {
        this.azimuth -= right;
        this.elevation = Math.min(Math.PI / 2 - 1e-3, Math.max(-Math.PI / 2 + 1e-3, this.elevation + up));
        this.draw();
    }

    zoom(factor: number): void {
        const size = Math.hypot(...this.box.max.map((high, axis) => high - this.box.min[axis]!)) || 1;
        this.distance = Math.min(size * 20, Math.max(size * 0.01, this.distance * factor));
        this.draw();
    }

    /** Moves what is looked at, in parts of the picture's height. */
    shift(right: number, up: number): void {
        const [sa, ca, se, ce] = [Math.sin(this.azimuth), Math.cos(this.azimuth), Math.sin(this.elevation), Math.cos(this.elevation)];
        const scale = this.distance * 0.7;
        const rightward: Vector = [-sa, ca, 0];
        const upward: Vector = [-se * ca, -se * sa, ce];
        this.target = this.target.map((at, axis) => at - scale * (right * rightward[axis]! + up * upward[axis]!)) as Vector;
        this.draw();
    }

    /** Draws with the next frame of the screen. */
    draw(): void {
        if (this.waiting || this.ended) return;
        this.waiting = true;
        requestAnimationFrame(() => {
            this.waiting = false;
            if (!this.ended) this.paint();
        });
    }

    private paint(): void {
        const { gl, canvas } = this;
        const ratio = Math.min(devicePixelRatio, 2);
        const [width, height] = [Math.max(1, Math.round(canvas.clientWidth * ratio)), Math.max(1, Math.round(canvas.clientHeight * ratio))];
        if (canvas.width !== width || canvas.height !== height) [canvas.width, canvas.height] = [width, height];
        gl.viewport(0, 0, width, height);
        gl.clearColor(0, 0, 0, 0);
        gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
        gl.enable(gl.DEPTH_TEST);
        const size = Math.hypot(...this.box.max.map((high, axis) => high - this.box.min[axis]!)) || 1;
        const view = this.view();
        const near = Math.max(this.distance - size * 1.2, size * 0.004);
        const projection = perspective(0.62, width / height, near, this.distance + size * 3);
        const style = getComputedStyle(canvas);
        const colour = (name: string): Vector => rgb(style.getPropertyValue(name));
        gl.useProgram(this.program);
        gl.uniformMatrix4fv(this.at(this.program, "view"), false, view);
        gl.uniformMatrix4fv(this.at(this.program, "projection"), false, projection);
        gl.uniform3fv(this.at(this.program, "colour"), colour("--part"));
        gl.uniform3fv(this.at(this.program, "inside"), colour("--inside"));
        const plane = [0, 0, 0, 1];
        if (this.cut) {
            plane[this.cut.axis] = 1;
            plane[3] = this.cut.at;
        }
        gl.uniform4fv(this.at(this.program, "plane"), plane);
        for (const tile of this.tiles.values()) {
            gl.bindVertexArray(tile.array);
            gl.drawArrays(gl.TRIANGLES, 0, tile.count);
        }
        this.paintLines(view, projection, colour);
        gl.bindVertexArray(null);
        this.frames += 1;
    }

    private paintLines(view: Float32Array, projection: Float32Array, colour: (name: string) => Vector): void {
        const { gl, box } = this;
        gl.useProgram(this.lineProgram);
        gl.uniformMatrix4fv(this.at(this.lineProgram, "view"), false, view);
        gl.uniformMatrix4fv(this.at(this.lineProgram, "projection"), false, projection);
        gl.bindVertexArray(this.lineArray);
        gl.bindBuffer(gl.ARRAY_BUFFER, this.lines);
        const corner = (index: number): Vector => [0, 1, 2].map((axis) => ((index >> axis) & 1 ? box.max[axis]! : box.min[axis]!)) as Vector;
        const edges: number[] = [];
        for (let index = 0; index < 8; index += 1) {
            for (let axis = 0; axis < 3; axis += 1) if (!((index >> axis) & 1)) edges.push(...corner(index), ...corner(index | (1 << axis)));
        }
        this.strokes(edges, [...colour("--frame"), 1]);
        const length = Math.max(...box.max.map((high, axis) => high - box.min[axis]!)) * 0.12;
        for (let axis = 0; axis < 3; axis += 1) {
            const end = [...box.min] as Vector;
            end[axis]! += length;
            this.strokes([...box.min, ...end], [...colour(["--axis-x", "--axis-y", "--axis-z"][axis]!), 1]);
        }
    }

    private strokes(places: number[], colour: number[]): void {
        const { gl } = this;
        gl.uniform4fv(this.at(this.lineProgram, "colour"), colour);
        gl.bufferData(gl.ARRAY_BUFFER, new Float32Array(places), gl.STREAM_DRAW);
        gl.drawArrays(gl.LINES, 0, places.length / 3);
    }

    private at(owner: WebGLProgram, name: string): WebGLUniformLocation | null {
        const known = this.places.get(owner) ?? new Map<string, WebGLUniformLocation | null>();
        this.places.set(owner, known);
        if (!known.has(name)) known.set(name, this.gl.getUniformLocation(owner, name));
        return known.get(name) ?? null;
    }

    private view(): Float32Array {
        const [sa, ca, se, ce] = [Math.sin(this.azimuth), Math.cos(this.azimuth), Math.sin(this.elevation), Math.cos(this.elevation)];
        const back: Vector = [ce * ca, ce * sa, se];
        const right: Vector = [-sa, ca, 0];
        const up: Vector = [-se * ca, -se * sa, ce];
        const eye = this.target.map((at, axis) => at + this.distance * back[axis]!) as Vector;
        const along = (axis: Vector): number => -(axis[0] * eye[0] + axis[1] * eye[1] + axis[2] * eye[2]);
        return new Float32Array([
            right[0], up[0], back[0], 0, right[1], up[1], back[1], 0, right[2], up[2], back[2], 0, along(right), along(up), along(back), 1,
        ]);
    }

    private control(signal: AbortSignal): void {
        const { canvas } = this;
        let held: { x: number; y: number } | null = null;
        canvas.addEventListener("pointerdown", (event) => {
            canvas.setPointerCapture(event.pointerId);
            held = { x: event.clientX, y: event.clientY };
        }, { signal });
        canvas.addEventListener("pointermove", (event) => {
            if (!held) return;
            const [dx, dy] = [event.clientX - held.x, event.clientY - held.y];
            held = { x: event.clientX, y: event.clientY };
            const height = canvas.clientHeight || 1;
            if (event.shiftKey || event.buttons & 6) this.shift(dx / height, -dy / height);
            else this.turn((dx / height) * 4, (dy / height) * 4);
        }, { signal });
        for (const name of ["pointerup", "pointercancel"]) canvas.addEventListener(name, () => (held = null), { signal });
        canvas.addEventListener("contextmenu", (event) => event.preventDefault(), { signal });
        canvas.addEventListener("wheel", (event) => {
            event.preventDefault();
            this.zoom(Math.exp(Math.max(-60, Math.min(60, event.deltaY)) * 0.004));
        }, { signal, passive: false });
        canvas.addEventListener("keydown", (event) => {
            const step = 0.12;
            const arrows: Record<string, [number, number]> = { ArrowLeft: [-step, 0], ArrowRight: [step, 0], ArrowUp: [0, -step], ArrowDown: [0, step] };
            const arrow = arrows[event.key];
            if (arrow) event.shiftKey ? this.shift(-arrow[0] / 2, arrow[1] / 2) : this.turn(arrow[0], -arrow[1]);
            else if (event.key === "+" || event.key === "=") this.zoom(0.87);
            else if (event.key === "-") this.zoom(1.15);
            else if (event.key === "Home" || event.key === "0") this.look("iso");
            else return;
            event.preventDefault();
        }, { signal });
    }
}

function program(gl: WebGL2RenderingContext, vertex: string, fragment: string): WebGLProgram {
    const made = gl.createProgram();
    for (const [kind, text] of [[gl.VERTEX_SHADER, vertex], [gl.FRAGMENT_SHADER, fragment]] as const) {
        const shader = gl.createShader(kind);
        if (!shader) throw new Error("the graphics were lost");
        gl.shaderSource(shader, text);
        gl.compileShader(shader);
        gl.attachShader(made, shader);
    }
    gl.linkProgram(made);
    if (!gl.getProgramParameter(made, gl.LINK_STATUS)) throw new Error(`no shaders: ${gl.getProgramInfoLog(made)}`);
    return made;
}

function perspective(angle: number, aspect: number, near: number, far: number): Float32Array {
    const scale = 1 / Math.tan(angle / 2);
    const range = 1 / (near - far);
    const wide = aspect < 1 ? scale * aspect : scale;
    return new Float32Array([wide / aspect, 0, 0, 0, 0, wide, 0, 0, 0, 0, (near + far) * range, -1, 0, 0, 2 * near * far * range, 0]);
}

/** A colour `#rrggbb` in parts of one. */
function rgb(text: string): Vector {
    const digits = parseInt(text.trim().slice(1), 16);
    return [((digits >> 16) & 255) / 255, ((digits >> 8) & 255) / 255, (digits & 255) / 255];
}
