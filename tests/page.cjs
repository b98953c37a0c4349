// Drives the page in headless chromium: every function of it, light and dark, with the keyboard, with keys, with none and with 200 scenes, and
// while the server is away. Any error on the console and any violation that axe finds fails. See tests/page.
"use strict";
const assert = require("node:assert/strict");
const { spawn, spawnSync } = require("node:child_process");
const fs = require("node:fs");
const os = require("node:os");
const path = require("node:path");
const { chromium } = require("playwright-core");

const [program, pictures] = process.argv.slice(2).map((name) => path.resolve(name));
const work = fs.mkdtempSync(path.join(os.tmpdir(), "union3d-page-"));
const axe = fs.readFileSync(require.resolve("axe-core/axe.min.js"), "utf8");
const servers = new Set();

/** Starts a server on this address; its own port when it is none. */
function serve(data, address = "127.0.0.1:0", ...more) {
    const server = spawn(program, ["serve", "--http", address, "--grpc", "127.0.0.1:0", "--data", path.join(work, data), ...more], {
        stdio: ["ignore", "pipe", "pipe"],
    });
    servers.add(server);
    server.ended = new Promise((resolve) => server.on("exit", () => (servers.delete(server), resolve())));
    return new Promise((resolve, reject) => {
        let said = "";
        let log = "";
        server.stderr.on("data", (text) => (log += text));
        server.stdout.on("data", (text) => {
            said += text;
            const found = /(http:\/\/127\.0\.0\.1:\d+)/.exec(said);
            if (found) resolve({ server, url: found[1] });
        });
        server.on("exit", () => reject(new Error(`the server ended: ${log}`)));
    });
}

async function stop({ server }) {
    server.kill("SIGTERM");
    await server.ended;
}

/** Asks the API as any client does. */
async function call(url, method, at, body, headers = {}) {
    const answer = await fetch(`${url}/v1/scenes${at}`, {
        method,
        headers: { "content-type": "application/json", ...headers },
        body: body === undefined ? undefined : JSON.stringify(body),
    });
    const text = await answer.text();
    assert.ok(answer.ok, `${method} ${at}: ${answer.status} ${text}`);
    return text ? JSON.parse(text) : null;
}

/** A pocket in a block, move by move; every fifth move goes back along the one before and cuts nothing. */
async function mill(url, scene, moves, first = 1) {
    for (let move = first; move < first + moves; move += 1) {
        const row = Math.floor(move / 5) * 5 + (move % 5 === 4 ? 3 : move % 5);
        const y = 8 + (row % 12) * 4;
        const z = -2 - 2 * Math.floor(row / 12);
        await call(url, "POST", `/${scene}/changes?return=minimal`, {
            insert: [{ id: move, shape: row % 2 ? "t1" : "t2", from: [10, y, z], to: [70, y, z] }],
            move,
            duration: 1.5 + (row % 3) / 4,
        });
    }
}

const BLOCK = {
    kind: "solids",
    stock: { min: [0, 0, -20], max: [80, 60, 0] },
    shapes: { t1: { flat: { diameter: 6, length: 30, sides: 32 } }, t2: { ball: { diameter: 6, length: 30 } } },
};

let passed = 0;
let failed = 0;
async function check(name, run) {
    try {
        await run();
        passed += 1;
        console.log(`ok       ${name}`);
    } catch (error) {
        failed += 1;
        console.log(`FAILED   ${name}\n${error.stack}`);
    }
}

/** A page whose errors are counted; what the browser says of answers that a check asks for is no error there. */
async function open(browser, options = {}) {
    const context = await browser.newContext({ viewport: { width: 1440, height: 1000 }, acceptDownloads: true, ...options });
    const page = await context.newPage();
    page.setDefaultTimeout(20_000);
    page.wrong = [];
    page.expected = null;
    const note = (text) => page.expected?.test(text) || page.wrong.push(text);
    page.on("console", (message) => ["error", "warning"].includes(message.type()) && note(message.text()));
    page.on("pageerror", (error) => note(String(error)));
    return page;
}

async function accessible(page, where) {
    // Injected as the test's own: the page's policy lets no script in.
    const found = await page.evaluate(`(() => { ${axe}; return axe.run(document, { resultTypes: ["violations"] }); })()`);
    const lines = found.violations.map((one) => `${one.id}: ${one.help}: ${one.nodes.map((node) => node.html + " " + node.failureSummary).join(" | ")}`);
    assert.deepEqual(lines, [], `axe in ${where}`);
}

const shoot = (page, name, whole = true) => page.screenshot({ path: path.join(pictures, `${name}.png`), fullPage: whole });

/** Waits until the text is there; says what is there instead. */
async function says(page, selector, text) {
    const has = ([selector, text]) => document.querySelector(selector)?.textContent.replaceAll("\u202f", "").includes(text);
    await page.waitForFunction(has, [selector, text]).catch(async () => {
        const found = await page.locator(selector).first().textContent({ timeout: 100 }).catch(() => "nothing");
        throw new Error(`${selector} says ${JSON.stringify(found)}, not ${JSON.stringify(text)}`);
    });
}

async function run(browser) {
    let one = await serve("one");
    const page = await open(browser);

    await check("without scenes there is a word about it, and nothing is wrong", async () => {
        await page.goto(one.url);
        await says(page, ".empty h2", "No scenes yet");
        await accessible(page, "the empty list");
        await shoot(page, "list-none");
    });

    await check("the server says what it may load, and knows what the browser has", async () => {
        const first = await fetch(`${one.url}/assets/page.js`);
        assert.match(first.headers.get("content-security-policy"), /default-src 'none'; script-src 'self'/);
        assert.equal(first.headers.get("content-type"), "text/javascript; charset=utf-8");
        const again = await fetch(`${one.url}/assets/page.js`, { headers: { "if-none-match": first.headers.get("etag") } });
        assert.equal(again.status, 304);
        assert.equal((await fetch(`${one.url}/assets/none.js`)).status, 404);
        const packed = await fetch(`${one.url}/`, { headers: { "accept-encoding": "gzip" } });
        assert.equal(packed.headers.get("content-encoding"), "gzip");
    });

    await check("a scene is created by the form, and what is wrong is said at its place", async () => {
        page.expected = /status of 422/;
        await page.getByLabel("Name", { exact: true }).fill("cubes-1");
        await page.getByLabel("Kind", { exact: true }).selectOption("cubes");
        await page.getByLabel("Edge", { exact: true }).fill("-6");
        await page.getByRole("button", { name: "Create" }).click();
        const edge = page.getByLabel("Edge", { exact: true });
        await page.waitForFunction(() => document.querySelector("[aria-invalid]"));
        assert.equal(await edge.getAttribute("aria-invalid"), "true");
        const wrong = await page.locator(`#${await edge.getAttribute("aria-describedby")}`).textContent();
        assert.match(wrong, /-6/);
        await accessible(page, "the form with a fault");
        await shoot(page, "create-wrong");
        await edge.fill("6");
        await page.getByRole("button", { name: "Create" }).click();
        await page.waitForURL("**/scenes/cubes-1");
        await says(page, "h1", "cubes-1");
        page.expected = null;
        assert.equal((await call(one.url, "GET", "/cubes-1")).edge, 6);
    });

    await check("cubes come in as CSV, NDJSON and JSON, and the totals follow", async () => {
        await page.locator("#bodies").fill("id,x,y,z\n1,0,0,0\n2,3,0,0\n3,20,0,0");
        await page.getByRole("button", { name: "Insert" }).click();
        await says(page, "form .said", "3 inserted");
        await says(page, ".totals", "540");
        await page.locator("#file").setInputFiles({
            name: "more.ndjson",
            mimeType: "application/x-ndjson",
            buffer: Buffer.from('{"insert":{"id":4,"at":[0,0,20]}}\n{"insert":{"id":5,"at":[0,3,20]}}\n'),
        });
        await page.getByRole("button", { name: "Insert" }).click();
        await says(page, ".totals caption", "5 cubes");
        await page.locator("#format").selectOption("application/json");
        await page.locator("#bodies").fill('{"delete": [3]}');
        await page.getByRole("button", { name: "Insert" }).click();
        await says(page, ".totals caption", "4 cubes");
        const now = await call(one.url, "GET", "/cubes-1/mass-properties");
        await says(page, ".totals", String(now.volume));
        page.expected = /status of 4\d\d/;
        await page.locator("#format").selectOption("text/csv");
        await page.locator("#bodies").fill("1,2");
        await page.getByRole("button", { name: "Insert" }).click();
        await says(page, "form .said", "line 1 has 2 values");
        await page.locator("#bodies").fill("9,1e99,0,0");
        await page.getByRole("button", { name: "Insert" }).click();
        await says(page, "form .said", "/insert/0/at/0");
        page.expected = null;
        await shoot(page, "cubes");
    });

    await call(one.url, "PUT", "/milled", BLOCK);
    await mill(one.url, "milled", 40);
    const meshes = (await fetch(`${one.url}/v1/scenes/milled/mesh`)).status === 200;
    if (!meshes) page.expected = /status of 404/;

    await check("a scene of solids with its totals, plots and air cuts", async () => {
        await page.goto(`${one.url}/scenes/milled`);
        await says(page, ".totals caption", "40 solids at seq 40");
        await says(page, ".past .note", "40 changes");
        const csv = await (await fetch(`${one.url}/v1/scenes/milled/history`, { headers: { accept: "text/csv" } })).text();
        const exact = csv.split("\n")[0].trim().split(",").indexOf("volume_removed_exact");
        const air = csv.trim().split("\n").slice(1).filter((line) => line.split(",")[exact] === "0").length;
        assert.ok(air > 0, "some moves cut nothing");
        await says(page, ".past .note", `${air} air cut`);
        assert.equal(await page.locator(".plots .uplot").count(), 3);
        const now = await call(one.url, "GET", "/milled/mass-properties");
        await says(page, ".totals", String(Number(now.remaining.volume.toPrecision(10))));
    });

    await check("the part is seen in three dimensions, turned, moved and sliced", async () => {
        if (!meshes) return says(page, ".under", "makes no meshes");
        await says(page, ".under", "triangles");
        const frames = () => page.evaluate(() => document.querySelector("canvas.picture").renderer.frames);
        const before = await frames();
        await page.locator("canvas.picture").focus();
        for (const key of ["ArrowLeft", "ArrowUp", "+", "-", "Shift+ArrowRight", "Home"]) await page.keyboard.press(key);
        const box = await page.locator("canvas.picture").boundingBox();
        await page.mouse.move(box.x + 200, box.y + 200);
        await page.mouse.down();
        await page.mouse.move(box.x + 260, box.y + 215, { steps: 4 });
        await page.mouse.up();
        await page.mouse.wheel(0, -120);
        await page.waitForFunction((before) => document.querySelector("canvas.picture").renderer.frames > before, before);
        await shoot(page, "milled");
        await page.getByLabel("Slice plane", { exact: true }).selectOption({ label: "slice x" });
        await page.getByLabel("Where the slice plane is").press("ArrowRight");
        await says(page, ".tools output", "x 40");
        await shoot(page, "sliced", false);
        await page.getByLabel("Slice plane", { exact: true }).selectOption({ label: "no slice" });
        for (const name of ["Front", "Top", "Right", "Iso"]) await page.getByRole("button", { name, exact: true }).click();
        for (const part of ["removed", "union", "remaining"]) {
            await page.getByLabel("Part", { exact: true }).first().selectOption(part);
            await says(page, ".under", "triangles");
            await shoot(page, `part-${part}`, false);
        }
    });

    await check("the page has nothing that keeps somebody out, light and dark", async () => {
        await accessible(page, "a scene, light");
        await page.emulateMedia({ colorScheme: "dark" });
        await page.waitForTimeout(300);
        await accessible(page, "a scene, dark");
        await shoot(page, "milled-dark");
        await page.emulateMedia({ colorScheme: "light" });
    });

    await check("the cursor goes through the history, by keyboard and by mouse", async () => {
        await page.locator("#scrub").focus();
        await page.keyboard.press("Home");
        await says(page, ".totals caption", "1 solid at seq 1");
        await page.keyboard.press("ArrowRight");
        await says(page, ".totals caption", "at seq 2");
        const past = await call(one.url, "GET", "/milled/mass-properties?at=2");
        await says(page, ".totals", String(Number(past.remaining.volume.toPrecision(10))));
        const over = await page.locator(".plots .u-over").first().boundingBox();
        await page.mouse.click(over.x + over.width / 2, over.y + over.height / 2);
        await says(page, ".scrub output", "seq 2");
        await shoot(page, "scrubbed");
        for (const axis of ["move", "time", "seq"]) {
            await page.locator("#axis").selectOption(axis);
            assert.equal(await page.locator(".plots .uplot").count(), 3);
        }
        await page.getByRole("button", { name: "Newest" }).click();
        await says(page, ".totals caption", "at seq 40");
    });

    await check("a running mill is seen as it cuts", async () => {
        await mill(one.url, "milled", 10, 41);
        await says(page, ".totals caption", "50 solids at seq 50");
        await says(page, ".past .note", "50 changes");
        if (meshes) await page.waitForFunction(() => !document.querySelector(".under").textContent.includes("to come"));
    });

    await check("meshes are saved", async () => {
        if (!meshes) return assert.ok(await page.locator(".formats").isHidden());
        for (const format of ["stl", "ply", "obj", "3mf", "glb"]) {
            const [saved] = await Promise.all([page.waitForEvent("download"), page.getByRole("button", { name: format.toUpperCase(), exact: true }).click()]);
            assert.equal(saved.suggestedFilename(), `milled-remaining.${format}`);
            assert.ok(fs.statSync(await saved.path()).size > 100, format);
        }
    });

    await check("a scene is reverted when that is confirmed", async () => {
        await page.locator("#scrub").focus();
        await page.keyboard.press("Home");
        await page.getByRole("button", { name: "Revert to here" }).click();
        await says(page, "dialog h2", "Revert to seq 1?");
        await accessible(page, "the question");
        await shoot(page, "revert", false);
        await page.getByRole("button", { name: "Cancel" }).click();
        assert.equal((await call(one.url, "GET", "/milled")).seq, 50);
        await page.getByRole("button", { name: "Revert to here" }).click();
        await page.getByRole("button", { name: "Revert", exact: true }).click();
        await says(page, ".totals caption", "1 solid at seq 51");
    });

    await check("it says that the server is away, and comes back with it", async () => {
        page.expected = /ERR_|status of 404/;
        const address = new URL(one.url).host;
        await stop(one);
        await says(page, "#trouble", "the server does not answer");
        await says(page, ".state", "not connected");
        await accessible(page, "a scene without its server");
        await shoot(page, "away", false);
        one = await serve("one", address);
        await says(page, ".state", "live");
        assert.ok(await page.locator("#trouble").isHidden());
        await mill(one.url, "milled", 1, 60);
        await says(page, ".totals caption", "at seq 52");
        page.expected = meshes ? null : /status of 404/;
    });

    await check("a scene is deleted when that is confirmed, by its name", async () => {
        // The stream of the scene may end before the list is there, and then the page asks what became of the scene.
        page.expected = /status of 404/;
        await page.getByRole("button", { name: "Delete the scene" }).click();
        await says(page, "dialog h2", "Delete milled?");
        await page.getByRole("button", { name: "Delete milled" }).click();
        await says(page, ".scenes", "cubes-1");
        const names = (await call(one.url, "GET", "")).scenes.map((scene) => scene.name);
        assert.deepEqual(names, ["cubes-1"]);
        page.expected = /status of 404/;
        await page.goto(`${one.url}/scenes/milled`);
        await says(page, "h1", "There is no such scene");
        page.expected = null;
    });

    await check("200 scenes are listed and found", async () => {
        for (let first = 0; first < 199; first += 20) {
            const names = Array.from({ length: Math.min(20, 199 - first) }, (_, index) => `part-${String(first + index).padStart(3, "0")}`);
            await Promise.all(names.map((name) => call(one.url, "PUT", `/${name}`, { edge: 1 })));
        }
        await page.goto(one.url);
        await says(page, ".note", "200 scenes, 200 running");
        assert.equal(await page.locator(".scenes tbody tr").count(), 200);
        await page.getByLabel("Find a scene").fill("part-19");
        await page.waitForFunction(() => document.querySelectorAll(".scenes tbody tr").length === 9);
        await shoot(page, "list-found");
        await page.getByLabel("Find a scene").fill("");
        await accessible(page, "200 scenes");
        await page.emulateMedia({ colorScheme: "dark" });
        await shoot(page, "list-200-dark", false);
        await page.emulateMedia({ colorScheme: "light" });
    });

    await check("problems are explained to people, and the API is described", async () => {
        await page.goto(`${one.url}/problems/id-conflict`);
        await says(page, "h1", "An id is at another place already");
        await accessible(page, "a problem");
        await shoot(page, "problem", false);
        await page.getByRole("link", { name: "Problems" }).first().click();
        await says(page, "h1", "What can go wrong");
        await accessible(page, "the problems");
        const asJson = await (await fetch(`${one.url}/problems/id-conflict`)).json();
        assert.equal(asJson.status, 409);
        await page.getByRole("link", { name: "API" }).click();
        await page.waitForSelector(".swagger-ui .opblock");
        assert.match(await page.title(), /^union3d/);
        assert.equal(await page.getByRole("link", { name: "The scenes of this server" }).getAttribute("href"), "/");
        await shoot(page, "docs", false);
    });

    await check("nothing was wrong on the console", () => assert.deepEqual(page.wrong, []));
    await page.context().close();
    await stop(one);

    await check("where there are keys the page asks for one, and keeps it out of addresses", async () => {
        const made = spawnSync(program, ["key", "new", "--name", "operator", "--rights", "admin", "--scenes", "*"], { encoding: "utf8" });
        const key = made.stderr.trim().split(/\s+/).at(-1);
        const file = path.join(work, "keys.toml");
        fs.writeFileSync(file, made.stdout, { mode: 0o600 });
        const guarded = await serve("one", "127.0.0.1:0", "--keys", file);
        const page = await open(browser);
        page.expected = /status of 40[14]/;
        await page.goto(`${guarded.url}/scenes/cubes-1`);
        await says(page, "dialog h2", "A key, please");
        await accessible(page, "the question for a key");
        await shoot(page, "key", false);
        await page.getByLabel("Key", { exact: true }).fill("wrong");
        await page.keyboard.press("Enter");
        await says(page, "dialog .wrong", "does not know the key");
        await page.getByLabel("Key", { exact: true }).fill(key);
        await page.keyboard.press("Enter");
        await says(page, ".totals caption", "4 cubes");
        await says(page, ".state", "live");
        await call(guarded.url, "POST", "/cubes-1/changes", { delete: [1] }, { authorization: `Bearer ${key}` });
        await says(page, ".totals caption", "3 cubes");
        assert.ok(!page.url().includes(key));
        await page.reload();
        await says(page, ".totals caption", "3 cubes");
        await page.getByRole("button", { name: "Forget the key" }).click();
        await says(page, "dialog h2", "A key, please");
        assert.deepEqual(page.wrong, []);
        await page.context().close();
        await stop(guarded);
    });
}

async function main() {
    fs.mkdirSync(pictures, { recursive: true });
    const browser = await chromium.launch({
        executablePath: "/usr/bin/chromium",
        args: [
            "--headless", "--no-sandbox", "--disable-quic", "--no-first-run", "--disable-background-networking", "--disable-component-update",
            "--disable-sync", "--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader",
        ],
    });
    try {
        await run(browser);
    } finally {
        await browser.close();
        for (const server of servers) server.kill("SIGKILL");
        fs.rmSync(work, { recursive: true, force: true });
    }
    console.log(`${passed} of ${passed + failed} checks of the page hold`);
    process.exitCode = failed === 0 ? 0 : 1;
}

main().catch((error) => {
    console.error(error);
    for (const server of servers) server.kill("SIGKILL");
    process.exit(1);
});
