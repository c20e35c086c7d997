// The page: everything starts here, and the keys that always work.

import * as calibrate from "./calibrate.js";
import * as charts from "./charts.js";
import { $, mayConfigure, mayOperate, number, say, self } from "./elements.js";
import * as excitation from "./excitation.js";
import * as history from "./history.js";
import * as learn from "./learn.js";
import { connect, link, on, release, take, vent } from "./link.js";
import * as loop from "./loop.js";
import * as operate from "./operate.js";
import * as reference from "./reference.js";
import * as settings from "./settings.js";

let state = null;

async function ventNow() {
  await vent();
  say("Vent asked for.");
}

$("vent").addEventListener("click", ventNow);
// Before anything else on the page hears of it.
addEventListener("keydown", (event) => {
  if (event.key === "Escape") {
    event.preventDefault();
    ventNow();
  }
}, true);
$("take").addEventListener("click", () => {
  released = false;
  take();
});
$("release").addEventListener("click", () => {
  released = true;
  release();
});

function banner(text, bad) {
  $("banner").hidden = !text;
  $("banner").className = bad ? "banner bad" : "banner";
  if ($("banner").textContent !== text) $("banner").textContent = text;
}

/** Whether it wants control that nobody has given it yet: until it has it, or somebody else does. What it asked for may be lost or late. */
let asking = true;
let held = false;
let wasEnergised = false;
/** Whether its user has given control back. */
let released = false;

function follow(value) {
  state = value;
  const { rig, identity, lease, problem } = value;
  const holds = lease?.client === self.number;
  const lost = held && !holds && !released;
  if (lost && wasEnergised) say("This page does not operate any more: it was silent for longer than limits.host_timeout_ms, and the rig vents.", true);
  held = holds;
  const parts = [identity?.board, identity?.firmware && `firmware ${identity.firmware}`, rig?.plant && `plant ${rig.plant}`,
    identity?.model_id ? `model ${identity.model_id}` : "no model"];
  $("identity").textContent = parts.filter(Boolean).join(" · ");
  $("now-state").textContent = rig?.phase ?? "–";
  $("now-state").dataset.phase = rig?.phase ?? "";
  $("lease").textContent = holds ? "You operate" : lease ? `Watching; ${lease.name} operates` : mayOperate() ? "Nobody operates" : "Watching";
  $("take").hidden = holds || Boolean(lease) || !mayOperate();
  $("release").hidden = !holds;
  banner(problem ? `The rig cannot be reached: ${problem}\nIt vents by itself; this page tries again.` : "", true);
  charts.nameFaults(identity?.fault_table ?? []);
  operate.follow(value, link.open && !problem);
  history.follow(rig?.mode === "displacement");
  learn.follow(value);
  calibrate.follow(value);
  reference.follow(value);
  // The first page that may operate does, unless somebody else does already; one that dozed off beside a vented rig goes on.
  if (lease) asking = false;
  else if (lost) asking = !wasEnergised;
  if (asking && mayOperate()) take();
  wasEnergised = ["armed", "running"].includes(rig?.phase);
  health();
}

function health() {
  const { rig, identity, watchers } = state ?? {};
  const account = rig?.account;
  $("health-rate").textContent = `${number(history.store.rate, 0)} /s`;
  $("health-lost").textContent = account ? `${account.dropped_by_device} device, ${account.lost_on_the_line} line` : "–";
  $("health-missed").textContent = String(link.missed);
  const cycles = history.store.longest;
  $("health-tick").textContent = cycles && identity?.cycles_per_tick ? `${number((100 * cycles) / identity.cycles_per_tick, 0)} % of 1 ms` : "not measured";
  $("health-late").textContent = String(history.store.late);
  $("health-watchers").textContent = String(watchers ?? "–");
  $("health-time").textContent = `${number(history.lastTime(), 1)} s${rig?.speed && rig.speed < 0.95 ? `, at ${number(rig.speed, 2)} of real time` : ""}`;
}

const TABS = { excitation, reference, learn, calibrate, settings, teach: { refresh() {} } };

function open(name, focus) {
  for (const other of Object.keys(TABS)) {
    const tab = $(`tab-${other}`);
    tab.setAttribute("aria-selected", String(other === name));
    tab.tabIndex = other === name ? 0 : -1;
    $(`page-${other}`).hidden = other !== name;
  }
  if (focus) $(`tab-${name}`).focus();
  TABS[name].refresh();
}

function tabs() {
  const names = Object.keys(TABS);
  names.forEach((name) => {
    $(`tab-${name}`).addEventListener("click", () => open(name));
    $(`tab-${name}`).addEventListener("keydown", (event) => {
      const step = { ArrowRight: 1, ArrowLeft: -1 }[event.key];
      if (!step) return;
      const there = names.filter((other) => !$(`tab-${other}`).hidden);
      open(there[(there.indexOf(name) + step + there.length) % there.length], true);
    });
  });
}

let painted = 0;
let pause = 45;

function paint(time) {
  requestAnimationFrame(paint);
  // As often as an eye needs it, and never so often that heartbeats have to wait.
  if (time - painted < pause) return;
  painted = time;
  const begun = performance.now();
  charts.draw();
  loop.draw();
  pause = Math.max(45, 4 * (performance.now() - begun));
}

let readAt = 0;

function read() {
  const now = performance.now();
  // Figures that change more often cannot be read.
  if (now - readAt < 120) return;
  readAt = now;
  $("now-pressure").textContent = number(history.last("pressure"), 3);
  $("now-displacement").textContent = number(history.last("displacement"), 3);
  health();
}

learn.start();
settings.start();
excitation.start();
reference.start();
calibrate.start();
operate.start();
loop.start();
charts.start();
tabs();
on("hello", () => {
  asking = true;
  history.clear();
  $("model-file").disabled = !mayConfigure();
  $("load-file").disabled = !mayOperate();
  open(Object.keys(TABS).find((name) => $(`tab-${name}`).getAttribute("aria-selected") === "true"));
});
on("state", follow);
on("samples", (...values) => {
  history.push(...values);
  read();
});
on("closed", () => {
  banner(self.token ? "No connection to the server. If the rig was armed, it has vented by itself; this page tries again."
    : "This page needs the address that `catheter dashboard` printed, token and all.", true);
  $("lease").textContent = "Not connected";
  if (state) operate.follow({ ...state, rig: null, lease: null }, false);
});
connect();
requestAnimationFrame(paint);
