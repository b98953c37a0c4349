/** Binary STL: 80 bytes, the number of triangles, and for each its normal, its corners and two bytes. Little-endian. */

import type { Mesh } from "./renderer";

const HEAD = 84;
const TRIANGLE = 50;

export function readStl(bytes: ArrayBuffer): Mesh {
    const view = new DataView(bytes);
    const triangles = bytes.byteLength >= HEAD ? view.getUint32(80, true) : 0;
    if (bytes.byteLength < HEAD || bytes.byteLength !== HEAD + TRIANGLE * triangles) throw new Error("the mesh is no binary STL, or broke off");
    const positions = new Float32Array(triangles * 9);
    const normals = new Int8Array(triangles * 12);
    for (let triangle = 0; triangle < triangles; triangle += 1) {
        const from = HEAD + TRIANGLE * triangle;
        for (let value = 0; value < 9; value += 1) positions[triangle * 9 + value] = view.getFloat32(from + 12 + 4 * value, true);
        for (let axis = 0; axis < 3; axis += 1) {
            const normal = Math.round(127 * view.getFloat32(from + 4 * axis, true));
            for (let corner = 0; corner < 3; corner += 1) normals[triangle * 12 + corner * 4 + axis] = normal;
        }
    }
    return { triangles, positions, normals };
}
