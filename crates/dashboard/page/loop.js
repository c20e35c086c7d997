// Two channels against each other, the newest strong, older ones paler: the hysteresis loop as it draws itself.

import { $, colour, make } from "./elements.js";
import { CHANNELS, lastTime, length, pairs } from "./history.js";

const SHADES = 24;
const POINTS = 2400;
let limits = null;
let drawnAt = -1;

function fill(select, chosen) {
  for (const [name, channel] of Object.entries(CHANNELS)) {
    select.append(make("option", { value: name, selected: name === chosen }, channel.short));
  }
  select.addEventListener("change", () => {
    limits = null;
    drawnAt = -1;
  });
}

/** Round numbers about so far apart. */
function steps(low, high, about) {
  const raw = (high - low) / about;
  const power = 10 ** Math.floor(Math.log10(raw));
  const step = [1, 2, 5, 10].map((factor) => factor * power).find((candidate) => candidate >= raw);
  const first = Math.ceil(low / step) * step;
  const digits = Math.max(0, -Math.floor(Math.log10(step)));
  return Array.from({ length: Math.floor((high - first) / step + 1e-9) + 1 }, (_, nth) => [first + nth * step, (first + nth * step).toFixed(digits)]);
}

/** Limits that grow with what is seen and shrink only when much less is: axes that breathe cannot be read. */
function fit(points) {
  const seen = [[Infinity, -Infinity], [Infinity, -Infinity]];
  for (const point of points) {
    for (const axis of [0, 1]) {
      if (!Number.isFinite(point[axis])) continue;
      seen[axis][0] = Math.min(seen[axis][0], point[axis]);
      seen[axis][1] = Math.max(seen[axis][1], point[axis]);
    }
  }
  return seen.map(([low, high], axis) => {
    if (low > high) [low, high] = [0, 1];
    const least = 0.4;
    if (high - low < least) [low, high] = [(low + high - least) / 2, (low + high + least) / 2];
    const [margin, old] = [0.06 * (high - low), limits?.[axis]];
    if (old && low >= old[0] && high <= old[1] && (high - low) > 0.5 * (old[1] - old[0])) return old;
    return [low - margin, high + margin];
  });
}

export function draw() {
  const canvas = $("loop");
  if (length() === 0 || drawnAt === lastTime()) return;
  drawnAt = lastTime();
  const ratio = devicePixelRatio;
  const [width, height] = [canvas.clientWidth, canvas.clientHeight];
  if (canvas.width !== Math.round(width * ratio) || canvas.height !== Math.round(height * ratio)) {
    canvas.width = Math.round(width * ratio);
    canvas.height = Math.round(height * ratio);
  }
  const context = canvas.getContext("2d");
  context.setTransform(ratio, 0, 0, ratio, 0, 0);
  context.clearRect(0, 0, width, height);
  const [x, y, tail] = [$("loop-x").value, $("loop-y").value, Number($("loop-tail").value)];
  const points = pairs(x, y, lastTime() - tail, POINTS);
  limits = fit(points);
  const [left, top, right, bottom] = [48, 8, width - 10, height - 36];
  const place = (value, [low, high], from, to) => from + ((value - low) / (high - low)) * (to - from);
  context.font = "11px sans-serif";
  context.lineWidth = 1;
  context.strokeStyle = colour("grid");
  context.fillStyle = colour("muted");
  context.textAlign = "center";
  for (const [value, text] of steps(...limits[0], 6)) {
    const at = Math.round(place(value, limits[0], left, right)) + 0.5;
    context.beginPath();
    context.moveTo(at, top);
    context.lineTo(at, bottom);
    context.stroke();
    context.fillText(text, at, bottom + 14);
  }
  context.textAlign = "right";
  for (const [value, text] of steps(...limits[1], 6)) {
    const at = Math.round(place(value, limits[1], bottom, top)) + 0.5;
    context.beginPath();
    context.moveTo(left, at);
    context.lineTo(right, at);
    context.stroke();
    context.fillText(text, left - 5, at + 4);
  }
  const title = (name) => `${CHANNELS[name].name}${CHANNELS[name].unit ? ` / ${CHANNELS[name].unit}` : ""}`;
  context.textAlign = "center";
  context.fillText(title(x), (left + right) / 2, height - 5);
  context.save();
  context.translate(11, (top + bottom) / 2);
  context.rotate(-Math.PI / 2);
  context.fillText(title(y), 0, 0);
  context.restore();
  context.strokeStyle = colour(y === "estimate" ? "estimate" : "laser");
  context.lineWidth = 1.6;
  context.lineJoin = "round";
  // Each shade begins at the last point of the one before.
  for (let shade = 0; shade < SHADES; shade++) {
    const from = Math.floor((points.length * shade) / SHADES);
    const to = Math.min(points.length, Math.floor((points.length * (shade + 1)) / SHADES) + 1);
    context.globalAlpha = 0.08 + 0.92 * ((shade + 1) / SHADES) ** 2;
    context.beginPath();
    let drawing = false;
    for (let nth = from; nth < to; nth++) {
      const [across, up] = points[nth];
      if (!Number.isFinite(across) || !Number.isFinite(up)) {
        drawing = false;
        continue;
      }
      const [px, py] = [place(across, limits[0], left, right), place(up, limits[1], bottom, top)];
      if (drawing) context.lineTo(px, py);
      else context.moveTo(px, py);
      drawing = true;
    }
    context.stroke();
  }
  context.globalAlpha = 1;
  const now = points.at(-1);
  if (now && Number.isFinite(now[0]) && Number.isFinite(now[1])) {
    context.fillStyle = colour("ink");
    context.beginPath();
    context.arc(place(now[0], limits[0], left, right), place(now[1], limits[1], bottom, top), 3.5, 0, 7);
    context.fill();
  }
}

export function start() {
  fill($("loop-x"), "pressure");
  fill($("loop-y"), "displacement");
  $("loop-tail").addEventListener("change", () => (drawnAt = -1));
}
