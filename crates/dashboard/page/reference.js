// References: a path of the tip, drawn, and followed by a controller of the device.

import { $, act, make, mayOperate, number, request, say, self } from "./elements.js";
import { sketch } from "./sketch.js";

const TITLES = {
  steps: "Steps", a: "A: decaying sine", b: "B: decaying triangle", c: "C: rising sine", d: "D: rising chirp", "point-to-point": "Point to point", hand: "Hand (synthetic)",
};
/** What a controller needs beside the laser and its gains. */
const NEEDS = {
  "pi-inverse": "a model", "physics-inverse": "a model", "learned-inverse": "an inverse model", "pi-inverse+pid": "a model", "physics-inverse+pid": "a model",
  sensorless: "a model",
};
let path = null;
let asked = 0;
let revision = -1;
/** Whether somebody chose the range: then it is theirs. */
let chosen = false;
/** Whether the rig and its operator are ready for one. */
let ready = false;

const wanted = () => ({
  name: $("reference-name").value, low_mm: Number($("reference-low").value), high_mm: Number($("reference-high").value), seed: Math.max(0, Math.round(Number($("reference-seed").value))),
});

export function draw() {
  if (path) sketch($("reference-canvas"), path.points_mm, path.points_mm.length * path.period_s, { unit: "mm" });
}

async function check() {
  const turn = ++asked;
  try {
    const answer = await request("POST", "/api/reference", wanted());
    if (turn !== asked) return;
    path = answer;
    $("reference-verdict").textContent = `${number(path.points_mm.length * path.period_s, 1)} s, from rest; the rig is vented at its end. ${path.note}`;
    $("reference-verdict").classList.remove("problem");
    draw();
  } catch (problem) {
    if (turn !== asked) return;
    path = null;
    $("reference-verdict").textContent = problem.message;
    $("reference-verdict").classList.add("problem");
  }
  enable();
}

function enable() {
  $("reference-go").disabled = !ready || !path;
}

function outcome({ controller, reference, rmse_mm: rmse, worst_mm: worst, output_span_bar: span, problem, share }) {
  const name = TITLES[reference] ?? reference;
  if (problem) return `${name} with ${controller} ended after ${number(100 * share, 0)} %: ${problem}`;
  // A rig that does not move follows nothing, whatever its error is.
  const still = span < 0.01 ? " The output did not move: this controller does nothing with these settings." : "";
  return `${name} with ${controller}: the laser was ${number(rmse, 3)} mm from the reference (root mean square), ${number(worst, 3)} mm at worst; the output moved over ${number(span, 2)} bar.${still}`;
}

export async function refresh() {
  try {
    const { controllers, references, followed, reach } = await request("GET", "/api/controllers");
    if (!$("reference-controller").childElementCount) {
      $("reference-controller").append(...controllers.map((name) => make("option", { value: name, selected: name === "open-loop" }, NEEDS[name] ? `${name} (needs ${NEEDS[name]})` : name)));
      $("reference-name").append(...references.map((name) => make("option", { value: name }, TITLES[name] ?? name)));
    }
    $("reference-outcome").textContent = followed ? outcome(followed) : "";
    $("reference-outcome").classList.toggle("problem", Boolean(followed?.problem));
    if (!chosen) [$("reference-low").value, $("reference-high").value] = reach.offered_mm;
    await check();
  } catch (problem) {
    $("reference-verdict").textContent = problem.message;
  }
}

export function follow(state) {
  const { rig } = state;
  const task = rig?.task?.kind === "follow" ? rig.task : null;
  ready = state.lease?.client === self.number && mayOperate() && !rig?.task && rig?.phase === "idle";
  enable();
  $("reference-end").hidden = !task;
  $("reference-run").hidden = !task;
  if (task) {
    $("reference-does").textContent = `${task.name}: ${task.does}.`;
    $("reference-share").value = task.share;
  }
  if (rig && rig.revision !== revision) {
    revision = rig.revision;
    refresh();
  }
}

export function start() {
  const field = (id, label, value, oninput) => make("label", {}, label, make("input", { id, type: "number", step: "any", value, class: "short", oninput }));
  const choose = () => {
    chosen = true;
    check();
  };
  $("page-reference").append(
    make("div", { class: "form" },
      make("label", {}, "Controller", make("select", { id: "reference-controller" })),
      make("label", {}, "Reference", make("select", { id: "reference-name", onchange: check })),
      field("reference-low", "Lowest / mm", null, choose), field("reference-high", "Highest / mm", null, choose), field("reference-seed", "Seed", 1, check)),
    make("canvas", { id: "reference-canvas", class: "preview", role: "img", "aria-label": "The reference over time" }),
    make("p", { id: "reference-verdict", role: "status" }),
    make("div", { class: "row" },
      make("button", { id: "reference-go", type: "button", class: "main", disabled: true,
        onclick: () => act("follow", { controller: $("reference-controller").value, reference: wanted() }) }, "Follow"),
      make("button", { id: "reference-end", type: "button", hidden: true, onclick: () => act("vent").then(() => say("Ended; the rig vents.")) }, "End and vent"),
      make("span", { class: "hint" }, "Arms, follows by the device's own clock, vents. Gains and model are those of the device: tune them under Record and learn.")),
    make("div", { id: "reference-run", class: "row", hidden: true }, make("strong", { id: "reference-does", role: "status" }),
      make("progress", { id: "reference-share", max: 1, value: 0, "aria-label": "Progress of the reference" })),
    make("p", { id: "reference-outcome", role: "status" }));
  new ResizeObserver(draw).observe($("reference-canvas"));
}
