// Excitations: chosen, drawn, checked against the rig's limits, and loaded; what is drawn is what the device will play.

import { $, act, download, make, number, request } from "./elements.js";
import { choose } from "./operate.js";
import { sketch } from "./sketch.js";

const field = (name, label, value, more = {}) => ({ name, label, value, step: "any", ...more });
const range = [field("minimum_bar", "Lowest / bar", 0), field("maximum_bar", "Highest / bar", 2)];
const KINDS = {
  "descending-sine": ["Descending sine (the paper's)", 20,
    [field("amplitude_bar", "Amplitude / bar", 1), field("frequency_hz", "Frequency / Hz", 0.3), field("decay_per_s", "Decay / 1/s", 0.05)]],
  triangle: ["Triangle", 20, [...range, field("frequency_hz", "Frequency / Hz", 0.2)]],
  staircase: ["Staircase", 16, [field("levels_bar", "Levels / bar", "0 0.5 1 1.5 2 1.5 1 0.5 0", { list: true }), field("ramp_s", "Ramp / s", 0.3)]],
  "first-order-reversal-curves": ["First-order reversal curves", 40, [...range, field("reversals", "Reversals", 6, { whole: true })]],
  chirp: ["Chirp", 30, [...range, field("frequency_start_hz", "From / Hz", 0.05), field("frequency_end_hz", "To / Hz", 1)]],
  "random-steps": ["Random steps", 30, [...range, field("rise_s", "Rise / s", 0.3), field("shortest_hold_s", "Shortest hold / s", 0.5),
    field("longest_hold_s", "Longest hold / s", 2)]],
  "random-points": ["Random points", 30, [...range, field("slowest_bar_per_s", "Slowest / bar/s", 0.3), field("fastest_bar_per_s", "Fastest / bar/s", 3),
    field("start_bar", "Start / bar", 0), field("end_bar", "End / bar", 0)]],
};

let preview = null;
let asked = 0;

function excitation() {
  const kind = $("excitation-kind").value;
  const signal = { kind };
  for (const { name, list, whole } of KINDS[kind][2]) {
    const text = $(`excitation-${name}`).value;
    signal[name] = list ? text.trim().split(/[\s,;]+/).map(Number) : whole ? Math.round(Number(text)) : Number(text);
  }
  return {
    sample_period_s: Number($("excitation-period").value) / 1000, seed: Number($("excitation-seed").value),
    segments: [{ duration_s: Number($("excitation-duration").value), signal }],
  };
}

function fields() {
  const [, duration, list] = KINDS[$("excitation-kind").value];
  $("excitation-duration").value = duration;
  $("excitation-fields").replaceChildren(...list.map(({ name, label, value, list: many, step }) => make("label", {}, label,
    make("input", { id: `excitation-${name}`, type: many ? "text" : "number", step, value, class: many ? "wide" : "short", oninput: check }))));
  check();
}

/** Draws what the server says would be played, and why it may not. */
async function check() {
  const turn = ++asked;
  try {
    const answer = await request("POST", "/api/preview", excitation());
    if (turn === asked) preview = answer;
  } catch (problem) {
    if (turn === asked) preview = { pressure_bar: [], period_s: 1, ceiling_bar: 3, problem: problem.message };
  }
  if (turn !== asked) return;
  const highest = preview.pressure_bar.reduce((most, value) => Math.max(most, value), 0);
  const seconds = preview.pressure_bar.length * preview.period_s;
  $("excitation-verdict").textContent = preview.problem ??
    `Within the limits: ${number(seconds, 1)} s, ${preview.pressure_bar.length} points, at most ${number(highest, 2)} of ${number(preview.ceiling_bar, 2)} bar.`;
  $("excitation-verdict").classList.toggle("problem", Boolean(preview.problem));
  $("excitation-load").disabled = Boolean(preview.problem);
  draw();
}

export function draw() {
  if (preview) sketch($("excitation-canvas"), preview.pressure_bar, preview.pressure_bar.length * preview.period_s, { unit: "bar", ceiling: preview.ceiling_bar, low: 0 });
}

export function start() {
  $("page-excitation").append(
    make("div", { class: "form" },
      make("label", {}, "Kind", make("select", { id: "excitation-kind", onchange: fields },
        ...Object.entries(KINDS).map(([name, [title]]) => make("option", { value: name }, title)))),
      make("label", {}, "Duration / s", make("input", { id: "excitation-duration", type: "number", min: 1, step: "any", class: "short", oninput: check })),
      make("label", {}, "Sample period / ms", make("input", { id: "excitation-period", type: "number", min: 1, max: 1000, step: 1, value: 20, class: "short", oninput: check })),
      make("label", {}, "Seed", make("input", { id: "excitation-seed", type: "number", min: 0, step: 1, value: 1, class: "short", oninput: check }))),
    make("div", { class: "form row", id: "excitation-fields" }),
    make("canvas", { id: "excitation-canvas", class: "preview", role: "img", "aria-label": "The command over time, with the ceiling" }),
    make("p", { id: "excitation-verdict", role: "status" }),
    make("div", { class: "row" },
      make("button", { id: "excitation-load", type: "button", class: "main", onclick: async () => {
        if (await act("load", { excitation: excitation() })) choose("playback");
      } }, "Load"),
      make("button", { type: "button", onclick: () => download("excitation.toml", preview?.file ?? "", "text/plain") }, "Save as a file"),
      make("span", { class: "hint" }, "Then arm and start; the device plays it by its own clock and disarms at its end.")));
  new ResizeObserver(draw).observe($("excitation-canvas"));
}

export const refresh = () => ($("excitation-fields").childElementCount ? check() : fields());
