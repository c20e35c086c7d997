// Small drawings: a command over time, and what was measured with the line through it.

import { colour, make, number } from "./elements.js";

/** Lowest and highest of as many stretches as there are places. */
function downsample(values, places) {
  const stride = Math.max(1, Math.ceil(values.length / places));
  const result = [];
  for (let at = 0; at < values.length; at += stride) {
    let [low, high] = [values[at], values[at]];
    for (let nth = at; nth < Math.min(values.length, at + stride); nth++) [low, high] = [Math.min(low, values[nth]), Math.max(high, values[nth])];
    result.push([low, high]);
  }
  return result;
}

/** A round step that divides a span into some four parts. */
function step(span) {
  const size = 10 ** Math.floor(Math.log10(span / 4));
  return [1, 2, 5, 10].map((factor) => factor * size).find((candidate) => span / candidate <= 5) ?? size;
}

const digits = (size) => Math.max(0, -Math.floor(Math.log10(size) + 1e-9));

/** Values over time on a canvas, from zero or the lowest up, with a ceiling where there is one. */
export function sketch(canvas, values, seconds, { unit, ceiling = null, low = null }) {
  if (!canvas || canvas.clientWidth === 0) return;
  const [width, height, ratio] = [canvas.clientWidth, canvas.clientHeight, devicePixelRatio];
  canvas.width = width * ratio;
  canvas.height = height * ratio;
  const context = canvas.getContext("2d");
  context.scale(ratio, ratio);
  const parts = downsample(values, width);
  const extremes = parts.flat();
  const top = Math.max(ceiling ?? -Infinity, ...extremes, (low ?? -Infinity) + 0.1);
  const bottom = low ?? Math.min(...extremes);
  if (!Number.isFinite(top - bottom)) return;
  const span = Math.max(1e-6, (top - bottom) * 1.08);
  const y = (value) => height - 18 - ((value - bottom) / span) * (height - 26);
  const x = (share) => 46 + share * (width - 56);
  const every = step(span);
  context.font = "11px sans-serif";
  context.fillStyle = colour("muted");
  context.strokeStyle = colour("grid");
  for (let value = Math.ceil(bottom / every) * every; value <= bottom + span; value += every) {
    context.strokeRect(x(0), y(value), x(1) - x(0), 0);
    context.fillText(`${number(value, digits(every))} ${unit}`, 2, y(value) + 4);
  }
  context.fillText("0 s", x(0), height - 3);
  context.textAlign = "right";
  context.fillText(`${number(seconds, 1)} s`, x(1), height - 3);
  if (ceiling !== null) {
    context.strokeStyle = colour("bad");
    context.setLineDash([6, 4]);
    context.beginPath();
    context.moveTo(x(0), y(ceiling));
    context.lineTo(x(1), y(ceiling));
    context.stroke();
    context.fillText("ceiling", x(1), y(ceiling) - 4);
    context.setLineDash([]);
  }
  context.strokeStyle = colour("measured");
  context.lineWidth = 1.5;
  context.beginPath();
  parts.forEach(([lowest, highest], nth) => {
    context.lineTo(x(nth / parts.length), y(lowest));
    context.lineTo(x(nth / parts.length), y(highest));
  });
  context.stroke();
}

const NAMESPACE = "http://www.w3.org/2000/svg";
const [WIDTH, HEIGHT, LEFT, BOTTOM] = [360, 210, 52, 36];
/** More dots cannot be told apart. */
const DOTS = 400;

function svg(tag, attributes, text) {
  const element = document.createElementNS(NAMESPACE, tag);
  for (const [name, value] of Object.entries(attributes)) element.setAttribute(name, value);
  if (text !== undefined) element.textContent = text;
  return element;
}

function bounds(values) {
  const [low, high] = values.reduce(([least, most], value) => [Math.min(least, value), Math.max(most, value)], [Infinity, -Infinity]);
  const margin = 0.05 * (high - low) || 0.5;
  return [low - margin, high + margin];
}

/** A curve of a calibration: dots that were measured, the line through them. */
export function curve({ title, horizontal, vertical, measured, fitted }) {
  const all = [...measured, ...fitted];
  const [[left, right], [low, high]] = [bounds(all.map(([value]) => value)), bounds(all.map(([, value]) => value))];
  const x = (value) => LEFT + ((value - left) / (right - left)) * (WIDTH - LEFT - 8);
  const y = (value) => HEIGHT - BOTTOM - ((value - low) / (high - low)) * (HEIGHT - BOTTOM - 8);
  const root = svg("svg", { viewBox: `0 0 ${WIDTH} ${HEIGHT}`, class: "curve", role: "img", "aria-label": `${title}: ${vertical} over ${horizontal}, measured and fitted` });
  const axis = (from, to, draw) => {
    const every = step(to - from);
    for (let value = Math.ceil(from / every) * every; value <= to; value += every) draw(value, number(value, digits(every)));
  };
  axis(left, right, (value, text) => {
    root.append(svg("line", { x1: x(value), x2: x(value), y1: 8, y2: HEIGHT - BOTTOM }), svg("text", { x: x(value), y: HEIGHT - BOTTOM + 13, class: "middle" }, text));
  });
  axis(low, high, (value, text) => {
    root.append(svg("line", { x1: LEFT, x2: WIDTH - 8, y1: y(value), y2: y(value) }), svg("text", { x: LEFT - 4, y: y(value) + 4, class: "end" }, text));
  });
  root.append(svg("text", { x: (LEFT + WIDTH) / 2, y: HEIGHT - 5, class: "middle" }, horizontal),
    svg("text", { x: 11, y: (HEIGHT - BOTTOM) / 2, class: "middle", transform: `rotate(-90 11 ${(HEIGHT - BOTTOM) / 2})` }, vertical));
  const every = Math.max(1, Math.ceil(measured.length / DOTS));
  for (let nth = 0; nth < measured.length; nth += every) {
    root.append(svg("circle", { cx: x(measured[nth][0]), cy: y(measured[nth][1]), r: measured.length > 60 ? 1.6 : 3 }));
  }
  root.append(svg("polyline", { points: fitted.map(([h, v]) => `${x(h).toFixed(1)},${y(v).toFixed(1)}`).join(" ") }));
  return make("figure", {}, make("figcaption", {}, title), root);
}
