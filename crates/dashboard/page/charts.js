// Time series by uPlot: pressure, displacement with the estimate and its bound, residual; live, or wherever the user looks.

import { $, colour, number } from "./elements.js";
import { marks, firstTime, lastTime, length, store, view } from "./history.js";

const SLEW = 1 << 3;
const LIMITS = (1 << 1) | (1 << 2);

/** What is seen: the last `span` seconds, or a fixed stretch. */
const seen = { span: 15, from: null, to: null };
let charts = [];
let faultNames = new Map();

export const isLive = () => seen.from === null;
export function nameFaults(table) {
  faultNames = new Map(table.map((fault) => [fault.number, fault.id]));
}

function range() {
  if (!isLive()) return [seen.from, seen.to];
  const to = lastTime();
  return [to - seen.span, to];
}

function look(from, to) {
  const width = Math.max(0.02, to - from);
  seen.from = Math.max(firstTime() - width / 2, from);
  seen.to = seen.from + width;
  tell();
}

function live() {
  seen.from = seen.to = null;
  tell();
}

function tell() {
  const button = $("pause");
  button.setAttribute("aria-pressed", String(!isLive()));
  button.textContent = isLive() ? "Pause" : "Live";
  draw(true);
}

/** A time on the axis, to the digits that tell it from the next one. */
const clock = (seconds, step) => {
  // Before the device started there was nothing.
  if (seconds < 0) return "";
  const minutes = Math.floor(seconds / 60);
  const rest = seconds - 60 * minutes;
  const digits = [0, 1, 2].find((count) => Math.abs(step * 10 ** count - Math.round(step * 10 ** count)) < 1e-6) ?? 3;
  return minutes > 0 ? `${minutes}:${rest.toFixed(digits).padStart(digits ? digits + 3 : 2, "0")}` : `${rest.toFixed(digits)} s`;
};

/** Strips for limits and lines for faults, behind the curves. */
function drawMarks(u) {
  const { ctx, bbox } = u;
  const [from, to] = range();
  const x = (time) => Math.min(bbox.left + bbox.width, Math.max(bbox.left, u.valToPos(time, "x", true)));
  const strip = 5 * devicePixelRatio;
  ctx.save();
  for (const [bits, name, row] of [[SLEW, "warn", 0], [LIMITS, "accent", 1]]) {
    ctx.fillStyle = colour(name);
    for (const [begin, end] of marks(from, to, bits).stretches) {
      ctx.fillRect(x(begin), bbox.top + row * strip, Math.max(devicePixelRatio, x(end) - x(begin)), strip - devicePixelRatio);
    }
  }
  ctx.fillStyle = ctx.strokeStyle = colour("bad");
  ctx.lineWidth = 2 * devicePixelRatio;
  ctx.font = `${11 * devicePixelRatio}px sans-serif`;
  for (const [time, fault] of marks(from, to, 0).struck) {
    ctx.beginPath();
    ctx.moveTo(x(time), bbox.top);
    ctx.lineTo(x(time), bbox.top + bbox.height);
    ctx.stroke();
    ctx.fillStyle = colour("ink");
    ctx.fillText(faultNames.get(fault) ?? `E${fault}`, x(time) + 4 * devicePixelRatio, bbox.top + 22 * devicePixelRatio);
  }
  ctx.restore();
}

const curve = (label, name, more = {}) => ({
  label, stroke: colour(name), width: 1.5, points: { show: false }, spanGaps: false,
  value: (_, value) => number(value ?? NaN, 3), ...more,
});

function options(element, unit, series, height, more = {}) {
  const axis = { stroke: colour("muted"), grid: { stroke: colour("grid"), width: 1 }, ticks: { stroke: colour("grid"), width: 1 }, font: "11px sans-serif" };
  return {
    width: Math.max(200, element.clientWidth),
    height,
    pxAlign: false,
    padding: [8, 8, 0, 0],
    legend: { live: true },
    cursor: { sync: { key: "time" }, drag: { x: true, y: false, setScale: false }, points: { size: 6 } },
    scales: { x: { time: false, range: () => range() }, y: { range: more.range } },
    axes: [
      { ...axis, values: (_, splits) => splits.map((seconds) => clock(seconds, splits[1] - splits[0])), size: 26 },
      { ...axis, label: unit, labelSize: 16, labelFont: "11px sans-serif", size: 48 },
    ],
    series: [{ label: "t", value: (_, value) => (value === null || value === undefined ? "–" : `${value.toFixed(3)} s`) }, ...series],
    bands: more.bands,
    hooks: {
      drawClear: more.marks ? [drawMarks] : [],
      setSelect: [(u) => {
        if (u.select.width > 4) look(u.posToVal(u.select.left, "x"), u.posToVal(u.select.left + u.select.width, "x"));
        u.setSelect({ left: 0, top: 0, width: 0, height: 0 }, false);
      }],
    },
  };
}

/** At least as high as the noise, so that a rig at rest looks at rest. */
const atLeast = (span, low = null) => (u, min, max) => {
  if (min === null || min === undefined) return [low ?? 0, (low ?? 0) + span];
  const middle = (min + max) / 2;
  const half = Math.max(span, (max - min) * 1.1) / 2;
  return low === null ? [middle - half, middle + half] : [Math.min(low, min - 0.02 * span), Math.max(low + span, max * 1.06)];
};

function build() {
  charts.forEach((chart) => chart.plot.destroy());
  charts = [];
  const add = (id, unit, names, series, height, more) => {
    const element = $(id);
    const plot = new uPlot(options(element, unit, series, height, more), [[], ...series.map(() => [])], element);
    plot.ctx.canvas.setAttribute("role", "img");
    plot.ctx.canvas.setAttribute("aria-label", `${series.map(({ label }) => label).slice(0, 2).join(" and ")} over time, ${unit}`);
    charts.push({ element, plot, names });
    pan(plot);
  };
  const tall = innerHeight > 1000 ? 240 : 200;
  add("chart-pressure", "bar", ["command", "pressure"], [curve("Commanded", "command", { dash: [6, 4] }), curve("Measured", "measured")], tall,
    { marks: true, range: atLeast(0.5, 0) });
  const unseen = (label) => curve(label, "estimate", { width: 0, class: "unseen" });
  add("chart-displacement", "mm", ["displacement", "estimate", "reference", "upper", "lower"],
    [curve("Laser", "laser"), curve("Estimate", "estimate"), curve("Reference", "command", { dash: [6, 4] }), unseen("Bound above"), unseen("Bound below")], tall,
    { range: atLeast(0.5), bands: [{ series: [4, 5], fill: colour("band") }] });
  add("chart-residual", "mm", ["residual"], [curve("Laser − estimate", "laser")], 130, { range: atLeast(0.1) });
  draw(true);
}

/** Shift and drag moves the stretch; the wheel zooms while paused; a double click goes back to live. */
function pan(plot) {
  const over = plot.over;
  over.addEventListener("mousedown", (event) => {
    if (!event.shiftKey) return;
    event.preventDefault();
    event.stopImmediatePropagation();
    const [from, to] = range();
    const scale = (to - from) / over.clientWidth;
    const move = (now) => look(from - (now.clientX - event.clientX) * scale, to - (now.clientX - event.clientX) * scale);
    addEventListener("mousemove", move);
    addEventListener("mouseup", () => removeEventListener("mousemove", move), { once: true });
  }, true);
  over.addEventListener("wheel", (event) => {
    if (isLive() && !event.ctrlKey) return;
    event.preventDefault();
    const [from, to] = range();
    const at = plot.posToVal(event.offsetX, "x");
    const factor = event.deltaY > 0 ? 1.25 : 0.8;
    look(at - (at - from) * factor, at + (to - at) * factor);
  }, { passive: false });
  over.addEventListener("dblclick", live);
}

let drawnAt = -1;

export function draw(always = false) {
  if (length() === 0 || (!always && (!isLive() || drawnAt === lastTime()))) return;
  drawnAt = lastTime();
  const [from, to] = range();
  $("chart-residual").hidden = !store.hasEstimate;
  for (const { element, plot, names } of charts) {
    if (element.hidden) continue;
    const own = names.filter((name) => name !== "upper" && name !== "lower");
    const data = view(from, to, Math.max(200, plot.width), own);
    if (names.includes("upper")) {
      const bounded = Number.isFinite(store.bound);
      const shifted = (by) => data[2].map((value) => (value === null || !bounded ? null : value + by));
      data.push(shifted(store.bound), shifted(-store.bound));
    }
    plot.batch(() => {
      plot.setData(data, false);
      plot.setScale("x", { min: from, max: to });
      plot.redraw(false, true);
    });
  }
}

export function start() {
  build();
  let width = 0;
  new ResizeObserver(() => {
    if ($("chart-pressure").clientWidth === width) return;
    width = $("chart-pressure").clientWidth;
    charts.forEach(({ element, plot }) => plot.setSize({ width: Math.max(200, element.clientWidth || width), height: plot.height }));
    draw(true);
  }).observe($("chart-pressure"));
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", build);
  const move = (share) => () => {
    const [from, to] = range();
    look(from + (to - from) * share, to + (to - from) * share);
  };
  const zoom = (factor) => () => {
    const [from, to] = range();
    // While live the newest sample stays where it is.
    if (isLive()) {
      seen.span = Math.min(260, Math.max(0.5, seen.span * factor));
      return draw(true);
    }
    const [middle, half] = [(from + to) / 2, ((to - from) / 2) * factor];
    look(middle - half, middle + half);
  };
  $("pause").addEventListener("click", () => (isLive() ? look(...range()) : live()));
  $("earlier").addEventListener("click", move(-0.25));
  $("later").addEventListener("click", move(0.25));
  $("closer").addEventListener("click", zoom(0.5));
  $("wider").addEventListener("click", zoom(2));
  $("window").addEventListener("change", (event) => {
    seen.span = Number(event.target.value);
    live();
  });
}
