// The calibration: what each step will do, what it asks and finds, which settings change, and a page to print.

import { $, act, make, mayConfigure, mayOperate, number, request, say, self } from "./elements.js";
import { curve } from "./sketch.js";

const WORDS = { open: "", running: "under way", found: "waits for you", taken: "in use", failed: "failed" };
let told = null;
let drawn = "";
let task = null;
let holds = false;
let phase = null;
let revision = -1;
let asked = "";

/** A value with its interval, as many digits as the interval is worth. */
function figure({ value, half_width: half }) {
  const places = (size) => (size > 0 ? Math.min(6, Math.max(0, 1 - Math.floor(Math.log10(size)))) : 4);
  return half > 0 ? `${number(value, places(half))} ± ${number(half, places(half))}` : number(value, Math.min(6, places(Math.abs(value)) + 2));
}

function found({ quantities, warnings, curves }, state) {
  // What is in use already does not push the next step away.
  const shown = make("details", { open: state !== "taken" }, make("summary", {}, "What it found"),
    make("table", {},
      make("thead", {}, make("tr", {}, ...["Figure", "Value", "Unit"].map((name, nth) => make("th", { scope: "col", class: nth === 1 ? "number" : null }, name)))),
      make("tbody", {}, ...quantities.map((quantity) => make("tr", {}, make("td", {}, quantity.name), make("td", { class: "number" }, figure(quantity)),
        make("td", {}, quantity.unit))))),
    make("div", { class: "curves" }, ...curves.filter(({ measured }) => measured.length > 0).map(curve)));
  return [
    ...warnings.map((warning) => make("p", { class: "reason" }, warning)), shown,
    state === "found" ? make("div", { class: "row" },
      make("button", { type: "button", class: "main", id: "calibrate-accept", onclick: accept }, "Use it"),
      make("span", { class: "hint" }, "The steps behind build on it. Nothing is saved yet.")) : null,
  ];
}

async function accept() {
  if (await act("accept")) say("In use, not saved yet.");
  await refresh();
}

function step({ name, title, explanation, state, problem, finding }, nth) {
  const runs = state === "running";
  return make("li", { class: `step ${state}`, "data-step": name },
    make("div", { class: "head" }, make("h3", {}, `${nth + 1}. ${title}`), make("span", { class: "badge" }, WORDS[state])),
    make("p", {}, explanation),
    problem ? make("p", { class: "reason fault" }, `It ended without a result: ${problem}`) : null,
    runs ? null : make("div", { class: "row" }, make("button", {
      type: "button", class: state === "open" || state === "failed" ? "main begin" : "begin", "data-step": name,
      onclick: () => act("calibrate", { step: name }).then(refresh),
    }, state === "open" ? "Begin" : "Repeat")),
    ...(finding ? found(finding, state) : []));
}

function changes() {
  const list = told.changes;
  $("calibrate-changes").replaceChildren(...list.map(({ name, before, after, unit }) => make("tr", {},
    make("td", {}, name), make("td", { class: "number" }, number(before, 5)), make("td", { class: "number" }, number(after, 5)), make("td", {}, unit))));
  $("calibrate-result").hidden = !told.steps.some(({ state }) => state === "taken");
}

function show() {
  $("calibrate-steps").replaceChildren(...told.steps.map(step));
  changes();
  enable();
}

function enable() {
  const may = holds && mayOperate() && !task && phase === "idle";
  document.querySelectorAll("#calibrate-steps button.begin").forEach((button) => (button.disabled = !may));
  for (const id of ["calibrate-accept", "calibrate-save", "calibrate-revert"]) if ($(id)) $(id).disabled = !may || !mayConfigure();
  $("calibrate-print").disabled = !mayOperate();
}

/** What runs: how far it is, and the question. */
function run() {
  const own = task?.kind === "calibrate" ? task : null;
  $("calibrate-run").hidden = !own;
  if (!own) {
    asked = "";
    return;
  }
  $("calibrate-does").textContent = `Step ${own.name}: ${own.does}.`;
  $("calibrate-share").value = own.share;
  $("calibrate-ask").hidden = !own.asks;
  const question = own.asks?.text ?? "";
  // Not while somebody types.
  if (question !== asked) {
    asked = question;
    if (own.asks) {
      $("calibrate-question").textContent = `${own.asks.text} `;
      $("calibrate-unit").textContent = own.asks.unit;
      $("calibrate-answer").value = own.asks.value ?? "";
      if (!$("page-calibrate").hidden) $("calibrate-answer").focus();
    }
  }
}

async function answer() {
  const field = $("calibrate-answer");
  const value = Number(field.value.replace(",", "."));
  if (field.value.trim() === "" || !Number.isFinite(value)) return say("A number is wanted.", true);
  await act("answer", { value });
}

export function follow(state) {
  const { rig } = state;
  [task, phase, holds] = [rig?.task ?? null, rig?.phase, state.lease?.client === self.number];
  run();
  if (rig && rig.revision !== revision) refresh();
  else if (told) enable();
}

export async function refresh() {
  try {
    const { revision: newest, ...answered } = await request("GET", "/api/calibration");
    revision = newest;
    // What is drawn already stays: somebody may be about to press a button of it.
    const words = JSON.stringify(answered);
    if (words === drawn) return;
    [told, drawn] = [answered, words];
    show();
  } catch (problem) {
    drawn = "";
    $("calibrate-steps").replaceChildren(make("li", {}, problem.message));
  }
}

async function print() {
  try {
    const { report, name } = await request("POST", "/api/calibration/page");
    const link = $("calibrate-link");
    link.href = report;
    link.textContent = `${name}.html`;
    link.hidden = false;
    say("The page is in the folder of recordings; its link opens it.");
    link.focus();
  } catch (problem) {
    say(problem.message, true);
  }
}

export function start() {
  const then = (action, words) => async () => {
    if (await act(action)) say(words);
    await refresh();
  };
  $("page-calibrate").append(
    make("p", { class: "hint" }, "Each step says what it will do, and can be repeated. What it finds is in use once you take it, and saved at the end. ",
      "Vent ends a step at any time; so does losing control of the rig."),
    make("div", { id: "calibrate-run", class: "run", hidden: true },
      make("div", { class: "row" }, make("strong", { id: "calibrate-does", role: "status" }),
        make("progress", { id: "calibrate-share", max: 1, value: 0, "aria-label": "Progress of the measurement" })),
      make("form", { id: "calibrate-ask", class: "row", hidden: true, onsubmit: (event) => {
        event.preventDefault();
        answer();
      } },
      make("label", { for: "calibrate-answer", id: "calibrate-question" }),
      make("input", { id: "calibrate-answer", class: "short", inputmode: "decimal", autocomplete: "off" }), make("span", { id: "calibrate-unit" }),
      make("button", { id: "calibrate-go", class: "main" }, "Go on"))),
    make("ol", { id: "calibrate-steps", class: "steps" }),
    make("section", { id: "calibrate-result", hidden: true, "aria-label": "Result of the calibration" },
      make("h3", {}, "Changed settings"),
      make("table", {}, make("thead", {}, make("tr", {}, ...["Setting", "Before", "Now", "Unit"].map((name, nth) =>
        make("th", { scope: "col", class: nth === 1 || nth === 2 ? "number" : null }, name)))), make("tbody", { id: "calibrate-changes" })),
      make("div", { class: "row" },
        make("button", { id: "calibrate-save", type: "button", class: "main", onclick: then("save", "Saved: the device starts with these settings from now on.") }, "Save to flash"),
        make("button", { id: "calibrate-revert", type: "button", onclick: then("revert", "The saved settings are in use.") }, "Revert all"),
        make("button", { id: "calibrate-print", type: "button", onclick: print }, "Page to print"),
        make("a", { id: "calibrate-link", target: "_blank", rel: "noopener", hidden: true }))));
}
