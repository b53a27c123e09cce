"use strict";
// The page of `lfpipe monitor --web`: draws the samples of /events and sends commands to /ctl.

const PERIOD_MS = 250, POINTS = 480;
const ink = (name) => getComputedStyle(document.documentElement).getPropertyValue(`--${name}`).trim();
const inkOf = (key) => ink(key) || ink("other"); // of a stage, or of the age
const $ = (id) => document.getElementById(id);
const page = { events: 0, latency: null, last: null };
window.lfpipe = page; // for the tests
history.replaceState(null, "", document.baseURI); // removes the token from the address; the cookie keeps it for this path

const axis = { stroke: () => ink("dim"), grid: { stroke: () => ink("line"), width: 1 }, ticks: { stroke: () => ink("line") } };
const rows = { t: [], lines: {} };

function wide(element) { return Math.max(240, element.clientWidth); }

const ms = (value) => value === null || value === undefined ? "" : `${value.toFixed(1)} ms`;

function makeLatency(names) {
  const newest = (plot, at, k) => ms(at === null ? plot.data[k][plot.data[k].length - 1] : at); // for the legend, also without a pointer
  const line = (name) => ({ label: name === "age" ? "age of pictures" : `${name} wait + busy`, value: newest, stroke: () => inkOf(name), width: name === "age" ? 2 : 1.2, points: { show: false } });
  const series = [{ label: "session time, s", value: (plot, at) => (at === null ? plot.data[0][plot.data[0].length - 1] : at)?.toFixed(1) ?? "" }, ...names.map(line)];
  const options = { width: wide($("latency")), height: 220, series, scales: { x: { time: false } }, axes: [{ ...axis, label: "session time, s", labelSize: 22, stroke: () => ink("dim") },
    { ...axis, label: "ms", labelSize: 22 }] };
  return new uPlot(options, [[], ...names.map(() => [])], $("latency"));
}

function charts(sample) {
  const newest = sample.stages.capture ? { age: sample.end_to_end.n ? sample.end_to_end.p50_ms : null } : {}; // without a camera, no frame ages
  for (const [name, stage] of Object.entries(sample.stages)) newest[name] = stage.busy.n ? stage.wait.p50_ms + stage.busy.p50_ms : null;
  const names = Object.keys(newest);
  if (page.latency === null || names.join() !== Object.keys(rows.lines).join()) {
    if (page.latency) page.latency.destroy();
    rows.t = []; rows.lines = Object.fromEntries(names.map((name) => [name, []]));
    page.latency = makeLatency(names);
  }
  rows.t.push(sample.uptime_s);
  for (const name of names) rows.lines[name].push(newest[name]);
  const lists = [rows.t, ...Object.values(rows.lines)];
  for (const list of lists) if (list.length > POINTS) list.shift();
  page.latency.setData(lists);
}

function table(sample) {
  const cells = (name, stage) => [[name], [stage.state.toLowerCase(), stage.state !== "RUNNING"], [stage.fps.toFixed(1)], [stage.wait.p50_ms.toFixed(2)],
    [stage.busy.p50_ms.toFixed(2)], [stage.busy.p95_ms.toFixed(2)], [stage.busy.p99_ms.toFixed(2)], [stage.max_ms.toFixed(2)],
    [stage.dropped, stage.dropped > 0], [stage.restarts, stage.restarts > 0], [stage.cpu_percent.toFixed(0)], [stage.cpus.join(" ")], [stage.rss_mb.toFixed(0)]];
  $("stages").replaceChildren(...Object.entries(sample.stages).map(([name, stage]) => {
    const row = document.createElement("tr");
    row.title = JSON.stringify(stage.metrics);
    for (const [text, bad] of cells(name, stage)) {
      const cell = document.createElement("td");
      cell.textContent = text;
      if (bad) cell.className = "bad";
      row.append(cell);
    }
    return row;
  }));
}

// Controls show the session's values, except for the control that the user is moving.
let held = "", heldUntil = 0;
const hold = (id) => { held = id; heldUntil = performance.now() + 1500; };
const free = (id) => held !== id || performance.now() > heldUntil;

let noted = 0;
function note(text) {
  clearTimeout(noted);
  $("note").textContent = text;
  noted = setTimeout(() => { $("note").textContent = ""; }, 20000); // longer than any answer takes
}

async function command(message) {
  try {
    const answer = await fetch("ctl", { method: "POST", headers: { "Content-Type": "application/json" }, body: JSON.stringify(message) });
    const reply = await answer.json();
    const said = Object.values(reply.stages || {}).map((stage) => stage.text || "").join("");
    note(reply.ok ? said : reply.error + (reply.remedy ? ` (${reply.remedy})` : ""));
    return reply.ok;
  } catch { note("The monitor has ended"); }
  return false;
}

// A control is busy until the session has answered and the value that it changes, if any, is another one.
async function press(control, message, value = () => null) {
  const before = value(), end = performance.now() + 5000;
  control.ariaBusy = "true";
  if (await command(message))
    while (before !== null && value() === before && performance.now() < end) await new Promise((done) => setTimeout(done, PERIOD_MS));
  control.ariaBusy = "false";
}

let waiting = null, busy = false; // the newest setting, and whether a request is running: sliders move faster than sessions answer
async function set(key, value) {
  waiting = { ...(waiting || {}), [key]: value };
  if (busy) return;
  busy = true;
  while (waiting) { const sets = waiting; waiting = null; await command({ cmd: "set", set: sets }); }
  busy = false;
}

// Where the mouse is the viewer, a pointer over the picture looks around: the newest place goes next.
let place = null, looking = false;
async function look(event) {
  if (!page.last || !page.last.mouse || document.body.classList.contains("watch")) return;
  const image = $("picture"), box = image.getBoundingClientRect();
  const scale = Math.min(box.width / image.naturalWidth, box.height / image.naturalHeight); // the picture fits into its box
  const share = (at, middle, size) => Math.min(Math.max((at - middle) / (size * scale) + 0.5, 0), 1);
  place = { x: share(event.clientX, box.left + box.width / 2, image.naturalWidth), y: share(event.clientY, box.top + box.height / 2, image.naturalHeight) };
  if (looking) return;
  looking = true;
  while (place) { const newest = place; place = null; await command({ cmd: "look", ...newest }); }
  looking = false;
}
for (const kind of ["pointerdown", "pointermove"]) $("picture").addEventListener(kind, look);

const GLASSES = {
  dubois: "red/cyan glasses", colour: "red/cyan glasses, full colours", "half-colour": "red/cyan glasses, half the colours",
  grey: "red/cyan glasses, grey", wimmer: "red/cyan glasses, muted reds", "dubois-green-magenta": "green/magenta glasses",
  "dubois-amber-blue": "amber/blue glasses", mono: "no glasses", "side-by-side": "a 3D television, side by side",
  "row-interleaved": "a 3D screen, row by row",
};
$("anaglyph").replaceChildren(...Object.entries(GLASSES).map(([value, text]) => new Option(text, value)));

function load(control, at) {
  note(`Opening ${page.last.playlist[at]} ...`);
  press(control, { cmd: "load", at });
}

function showScenes(sample) {
  const scenes = sample.playlist || [], at = sample.playlist_at;
  for (const place of document.querySelectorAll("[data-scene]")) place.textContent = sample.scene || "";
  $("scenes").hidden = $("steps").hidden = scenes.length < 2;
  $("number").textContent = scenes.length < 2 ? "" : `${at + 1} of ${scenes.length}`;
  if ($("scene").options.length !== scenes.length) $("scene").replaceChildren(...scenes.map((name) => new Option(name)));
  if (free("scene")) $("scene").selectedIndex = at;
}

function show(sample) {
  const render = sample.config && sample.config.render;
  if (!render) return;
  const glasses = GLASSES[render.anaglyph].split(",")[0], first = glasses.split("/")[0]; // in front of the left eye
  $("wear").hidden = !glasses.includes("/");
  $("wear").textContent = `Put on ${glasses}, ${first} on the ${render.swap_eyes ? "right" : "left"}.`;
  for (const key of ["anaglyph", "method"]) if (free(key)) $(key).value = render[key];
  if (free("depth")) $("depth").value = render.depth;
  if (sample.depth_px && free("zero")) [$("zero").min, $("zero").max, $("zero").step] = [sample.depth_px[0], sample.depth_px[1], sample.depth_px[2] / 5];
  if (free("zero") && typeof render.zero_plane_px === "string") $("zero_out").textContent = render.zero_plane_px;
  else if (free("zero")) { $("zero").value = render.zero_plane_px; $("zero_out").textContent = `${render.zero_plane_px.toFixed(2)} px/view`; }
  if (free("ghost")) { $("ghost").value = render.ghost_compensation; $("ghost_out").textContent = `${render.ghost_compensation.toFixed(0)} %`; }
  showScenes(sample);
  const auto = typeof render.alpha_px === "string";
  if (free("alpha")) {
    $("alpha_auto").checked = auto;
    if (!auto) $("alpha").value = Math.log10(render.alpha_px);
    $("alpha_out").textContent = auto ? render.alpha_px : `${render.alpha_px.toFixed(1)} px/view`;
  }
  $("around").hidden = !sample.mouse;
  document.body.classList.toggle("looks", sample.mouse);
  $("record").textContent = sample.recording ? "Stop recording" : "Record";
  $("pause").textContent = sample.paused ? "Resume" : "Pause";
}

const alphaOf = (slider) => Math.round(10 * 10 ** Number(slider)) / 10; // the slider is logarithmic: 1 to 1000 px

function range(id, key, text, value = Number) {
  $(id).addEventListener("input", () => { hold(id); const v = value($(id).value); $(`${id}_out`).textContent = text(v); set(key, v); });
}
range("zero", "render.zero_plane_px", (v) => `${v.toFixed(2)} px/view`);
range("ghost", "render.ghost_compensation", (v) => `${v.toFixed(0)} %`);
range("alpha", "render.alpha_px", (v) => `${v.toFixed(1)} px/view`, alphaOf);
for (const key of ["anaglyph", "method"]) $(key).addEventListener("change", () => { hold(key); set(`render.${key}`, $(key).value); });
$("scene").addEventListener("change", () => { hold("scene"); load($("scene"), $("scene").selectedIndex); });
$("alpha_auto").addEventListener("change", () => {
  hold("alpha");
  set("render.alpha_px", $("alpha_auto").checked ? "auto" : alphaOf($("alpha").value));
});
for (const word of ["recentre", "reset"]) $(word).addEventListener("click", () => press($(word), { cmd: word }));
for (const [id, name] of [["screenshot", "screenshot"], ["glasses_test", "glasses"]])
  $(id).addEventListener("click", () => press($(id), { cmd: "action", name }));
$("record").addEventListener("click", () => press($("record"), { cmd: "action", name: "record" }, () => page.last.recording));
$("pause").addEventListener("click", () => press($("pause"), { cmd: $("pause").textContent.toLowerCase() }, () => page.last.paused));
$("depth").addEventListener("input", () => { hold("depth"); set("render.alpha_px", "auto"); set("render.depth", Number($("depth").value)); });
const pressSet = (id, key, value) => press($(id), { cmd: "set", set: { [key]: value } });
$("swap").addEventListener("click", () => pressSet("swap", "render.swap_eyes", !page.last.config.render.swap_eyes));
$("near").addEventListener("click", () => pressSet("near", "scene.invert_depth", page.last.depth_inverted ? "no" : "yes"));
for (const [id, by] of [["previous", -1], ["next", 1]])
  $(id).addEventListener("click", () => load($(id), (page.last.playlist_at + by + page.last.playlist.length) % page.last.playlist.length));
$("class").hidden = !$("code").getAttribute("src"); // an address of this machine alone is for nobody else
$("full").addEventListener("click", () => document.querySelector(".screen").requestFullscreen());
$("numbers").addEventListener("toggle", fit);

function draw(event) {
  const sample = JSON.parse(event.data);
  page.events += 1;
  countRecording(page.last, sample);
  page.last = sample;
  document.body.classList.toggle("ended", !sample.alive);
  document.body.classList.toggle("running", sample.alive && !sample.paused);
  if (!sample.alive) { end("The session has ended", "no session; waiting for one"); return; }
  const minutes = Math.floor(sample.uptime_s / 60), seconds = Math.floor(sample.uptime_s % 60).toString().padStart(2, "0");
  say(`${sample.paused ? "Paused" : "Running"}, ${minutes ? `${minutes} min` : `${seconds} s`}`);
  const capture = sample.stages.capture;
  $("eyes").hidden = !capture || capture.state === "NONE" || !$("camera").src;
  const viewer = sample.mouse ? "no camera: drag over the picture" : `camera ${sample.camera_fps.toFixed(0)} Hz, viewer ${sample.viewer}`;
  $("state").textContent = `up ${minutes}:${seconds}, ${viewer}${sample.paused ? ", paused" : ""}`
    + `${sample.level ? `, quality lowered to ${sample.level_words} (${sample.level} of ${sample.lowest_level})` : ""}`
    + `${sample.end_to_end.n ? `; age of pictures ${sample.end_to_end.p50_ms.toFixed(0)} ms (worst 1 %: ${sample.end_to_end.p99_ms.toFixed(0)})` : ""}`
    + `${sample.prediction.n ? `, eyes predicted by ${sample.prediction.p50_ms.toFixed(0)} ms` : ""}${sample.motion_to_photon ? `; motion to photon: ${sample.motion_to_photon}` : ""}`;
  charts(sample); table(sample); show(sample);
}

function say(text) { $("short").lastElementChild.textContent = text; }

function end(text, state) {
  say(text);
  $("waiting").textContent = text;
  $("wear").hidden = $("recording").hidden = true;
  $("state").textContent = state;
}

let recorded_s = 0; // pauses are not in it
function countRecording(before, sample) {
  const going = before && before.recording && sample.recording && !sample.paused;
  recorded_s = !sample.recording ? 0 : recorded_s + (going ? sample.uptime_s - before.uptime_s : 0);
  $("recording").hidden = !sample.recording;
  $("recording").lastElementChild.textContent = `Recording ${Math.floor(recorded_s / 60)}:${Math.floor(recorded_s % 60).toString().padStart(2, "0")}`;
}

let events = null; // a hidden page does not listen

function connect() {
  if (events) events.close();
  if (document.hidden) return;
  const opened = events = new EventSource("events");
  opened.onmessage = draw;
  for (const which of ["camera", "picture"])
    opened.addEventListener(which, (event) => {
      $(which).src = `data:image/jpeg;base64,${event.data}`;
      if (which === "picture") { $(which).hidden = false; $("waiting").hidden = true; }
    });
  opened.onerror = async () => {
    page.last = null;
    document.body.classList.remove("running");
    document.body.classList.add("ended");
    end("The monitor has ended", "open the address that it prints when it starts again");
    if (opened.readyState !== EventSource.CLOSED) return; // the browser reconnects automatically
    const answer = await fetch("events").catch(() => null); // the reason for the refusal
    if (answer && answer.ok) answer.body.cancel();
    else if (answer) $("state").textContent = (await answer.json()).error;
    setTimeout(() => { if (events === opened) connect(); }, 20 * PERIOD_MS);
  };
}
document.addEventListener("visibilitychange", connect);

function fit() {
  if (page.latency) page.latency.setSize({ width: wide($("latency")), height: 220 });
}
addEventListener("resize", fit);
connect();
