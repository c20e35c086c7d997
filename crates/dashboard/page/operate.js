// The state machine as a picture, what stands in the way and what to do, and the buttons.

import { $, act, make, mayOperate, number, self } from "./elements.js";

const SVG = "http://www.w3.org/2000/svg";
const STATES = {
  boot: [8, 20, "boot"], "self-test": [8, 78, "self-test"], idle: [112, 49, "idle"], armed: [216, 49, "armed"], running: [320, 49, "running"],
  fault: [216, 122, "fault"],
};
const SIZE = [76, 32];
const ARROWS = [
  ["M46 52 V78", "M46 78"], ["M84 88 L112 72", ""], ["M188 60 H216", ""], ["M216 70 H188", ""], ["M292 60 H320", ""], ["M320 70 H292", ""],
  ["M254 81 V122", ""], ["M358 81 V138 H292", ""], ["M216 138 H46 V110", ""],
];
const ENERGISED = ["armed", "running"];
export const NAMES = ["boot", "self-test", "idle", "armed", "running", "fault"];

function svg(tag, attributes, text) {
  const element = document.createElementNS(SVG, tag);
  for (const [name, value] of Object.entries(attributes)) element.setAttribute(name, value);
  if (text) element.textContent = text;
  return element;
}

function picture() {
  const root = svg("svg", { viewBox: "0 0 404 160", class: "machine", role: "img", id: "machine-picture", "aria-label": "State machine" });
  const marker = svg("marker", { id: "tip", viewBox: "0 0 8 8", refX: 7, refY: 4, markerWidth: 7, markerHeight: 7, orient: "auto" });
  marker.append(svg("path", { d: "M0 0 L8 4 L0 8 Z", class: "tip" }));
  const defs = svg("defs", {});
  defs.append(marker);
  root.append(defs, svg("rect", { x: 206, y: 26, width: 196, height: 66, rx: 6, class: "zone" }));
  root.append(svg("text", { x: 396, y: 17, class: "zone-name" }, "dump valve closed: pressure possible"));
  for (const [path] of ARROWS) root.append(svg("path", { d: path, "marker-end": "url(#tip)" }));
  for (const [name, [x, y, label]] of Object.entries(STATES)) {
    const group = svg("g", { "data-phase": name });
    group.append(svg("rect", { x, y, width: SIZE[0], height: SIZE[1], rx: 5 }), svg("text", { x: x + SIZE[0] / 2, y: y + SIZE[1] / 2 }, label));
    root.append(group);
  }
  return root;
}

let rig = null;
let holds = false;
let connected = false;

export const mode = () => document.querySelector("input[name=mode]:checked").value;
export const isEnergised = () => ENERGISED.includes(rig?.phase);

/** Reasons as people read them: what, why, what to do. */
function reasons() {
  if (!rig) return [];
  const list = [];
  const line = (entry, kind) => make("div", { class: `reason ${kind}` }, make("b", {}, `${entry.id} ${entry.name}`), " ",
    entry.meaning, make("span", {}, make("strong", {}, "What to do: "), entry.remedy));
  rig.faults.forEach((fault, nth) => {
    const element = line(fault, "fault");
    if (nth === 0 && rig.fault_record) element.append(make("span", { class: "circumstances" }, rig.fault_record));
    list.push(element);
  });
  // That the state is another one, or a fault is latched, is seen already.
  if (rig.phase === "idle" || rig.phase === "fault") {
    rig.blockers.filter((blocker) => !["wrong-state", "fault-latched"].includes(blocker.name)).forEach((blocker) => list.push(line(blocker, "")));
  }
  if (list.length === 0 && rig.phase === "idle" && !rig.task) list.push(make("div", { class: "reason fine" }, "Vented and ready. Nothing blocks arming."));
  if (rig.task) {
    list.push(make("div", { class: "reason" }, rig.task.kind === "follow" ? "A reference runs by itself. Vent ends it." : "A step of the calibration runs by itself. Vent ends it."));
  } else if (rig.phase === "armed") list.push(make("div", { class: "reason" }, "Armed: the dump valve is closed, the output is zero. Start lets the output move."));
  return list;
}

let shown = "";

function explain() {
  const key = JSON.stringify([rig?.phase, rig?.task?.kind, rig?.faults, rig?.fault_record, rig?.phase === "idle" || rig?.phase === "fault" ? rig.blockers : 0]);
  if (key === shown) return;
  shown = key;
  $("why").replaceChildren(...reasons());
}

function buttons() {
  // What runs by itself is ended by venting.
  const may = holds && connected && mayOperate() && !rig?.task;
  const phase = rig?.phase;
  const enabled = {
    arm: phase === "idle" && (mode() !== "playback" || rig.playing), start: phase === "armed", stop: phase === "running",
    disarm: isEnergised(), acknowledge: phase === "fault",
  };
  for (const [name, able] of Object.entries(enabled)) $(name).disabled = !(may && able);
  document.querySelectorAll("input[name=mode]").forEach((input) => (input.disabled = !may || isEnergised()));
  $("slider").disabled = $("exact").disabled = $("set").disabled = !may || mode() === "playback";
  $("hold").hidden = mode() === "playback";
  $("arm").title = phase === "idle" && mode() === "playback" && !rig.playing ? "Load an excitation first" : "";
}

let scaled = "";

/** The slider's scale ends at the ceiling; what lies beyond is hatched. */
function scale() {
  const pressure = mode() === "pressure";
  const top = pressure ? (rig?.ceiling_bar ?? 3) : 20;
  const key = `${mode()} ${top}`;
  if (key === scaled) return;
  scaled = key;
  for (const input of [$("slider"), $("exact")]) {
    input.max = top;
    input.step = pressure ? 0.01 : 0.05;
  }
  $("beyond").hidden = !pressure;
  const step = top > 8 ? 5 : top > 4 ? 2 : top > 1.5 ? 0.5 : 0.1;
  const marks = [];
  // Positions by the style object: a style attribute is what the page's policy forbids.
  const mark = (value, text, name) => {
    const element = make("span", { class: name }, text);
    element.style.left = `${(value / top) * 100}%`;
    marks.push(element);
  };
  for (let value = 0; value < top * (pressure ? 0.6 : 0.95); value += step) mark(value, number(value, step < 0.5 ? 1 : step < 1 ? 1 : 0));
  mark(top, pressure ? `ceiling ${number(top, 2)} bar` : `${top} mm`, pressure ? "ceiling" : null);
  $("ticks").replaceChildren(...marks);
  put(Math.min(Number($("slider").value), top));
}

function put(value) {
  $("slider").value = $("exact").value = value;
  $("slider-value").textContent = `${number(Number(value), 2)} ${mode() === "displacement" ? "mm" : "bar"}`;
}

let sending = false;
let wanted = null;

/** The newest value goes out, those that it overtook do not. */
async function hold(value) {
  put(value);
  if (rig?.phase !== "running") return;
  wanted = Number(value);
  if (sending) return;
  sending = true;
  while (wanted !== null) {
    const next = wanted;
    wanted = null;
    await act("hold", { value: next });
  }
  sending = false;
}

export function follow(state, open) {
  rig = state.rig;
  connected = open;
  holds = state.lease?.client === self.number;
  const phase = rig?.phase;
  document.querySelectorAll("#machine g[data-phase]").forEach((group) => {
    group.setAttribute("class", group.dataset.phase === phase ? `now ${isEnergised() ? "energised" : phase}` : "");
  });
  $("machine-picture")?.setAttribute("aria-label", `State machine; the device is in the state ${phase ?? "unknown"}`);
  explain();
  scale();
  buttons();
  const playing = rig?.playing;
  $("progress").hidden = !playing || mode() !== "playback";
  if (playing) $("progress").textContent = `Excitation loaded: ${playing.points} points, ${playing.sent} sent to the device.`;
}

export function choose(name) {
  document.querySelector(`input[name=mode][value=${name}]`).checked = true;
  scale();
  buttons();
}

export function start() {
  $("machine").append(picture());
  $("arm").addEventListener("click", () => act("arm", { mode: mode() }));
  $("start").addEventListener("click", () => act("start", mode() === "playback" ? {} : { value: Number($("slider").value) }));
  $("stop").addEventListener("click", () => act("stop"));
  $("disarm").addEventListener("click", () => act("disarm"));
  $("acknowledge").addEventListener("click", () => act("acknowledge"));
  $("slider").addEventListener("input", (event) => hold(event.target.value));
  $("set").addEventListener("click", () => $("exact").checkValidity() ? hold($("exact").value) : $("exact").reportValidity());
  $("exact").addEventListener("keydown", (event) => event.key === "Enter" && $("set").click());
  document.querySelectorAll("input[name=mode]").forEach((input) => input.addEventListener("change", () => {
    scaled = "";
    put(0);
    scale();
    buttons();
  }));
}
