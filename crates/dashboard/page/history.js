// What the rig did: the last minutes of samples, column by column, in rings.

const SIZE = 1 << 18;
const MASK = SIZE - 1;
const HEADER = 16;

export const CHANNELS = {
  command: { name: "Commanded pressure", short: "Command", unit: "bar", at: 16 },
  output: { name: "Output", short: "Output", unit: "bar", at: 20 },
  set: { name: "Set-point", short: "Set-point", unit: "", at: 24 },
  pressure: { name: "Measured pressure", short: "Pressure", unit: "bar", at: 28 },
  displacement: { name: "Displacement (laser)", short: "Laser", unit: "mm", at: 32 },
  estimate: { name: "Estimate", short: "Estimate", unit: "mm", at: 36 },
  residual: { name: "Residual", short: "Residual", unit: "mm" },
  reference: { name: "Reference", short: "Reference", unit: "mm" },
};
const RUNNING = 4;
/** Whether set-points are displacements. */
let inMillimetres = false;
export const follow = (displacement) => (inMillimetres = displacement);

const columns = { time: new Float64Array(SIZE) };
for (const name of Object.keys(CHANNELS)) columns[name] = new Float32Array(SIZE);
const notices = new Uint32Array(SIZE);
const phases = new Uint8Array(SIZE);
const faults = new Uint8Array(SIZE);
let begin = 0;
let end = 0;

export const store = { bound: NaN, hasEstimate: false, rate: 0, late: 0, longest: 0 };
export const length = () => end - begin;
export const lastTime = () => (end > begin ? columns.time[(end - 1) & MASK] : 0);
export const firstTime = () => (end > begin ? columns.time[begin & MASK] : 0);
export const last = (name) => (end > begin ? columns[name][(end - 1) & MASK] : NaN);
export const lastPhase = () => (end > begin ? phases[(end - 1) & MASK] : 0);

export function clear() {
  begin = end = 0;
}

export function push(view, size, count, bound) {
  store.bound = bound;
  for (let nth = 0; nth < count; nth++) {
    const at = HEADER + nth * size;
    const time = view.getFloat64(at, true) / 1000;
    // The device has started again: its time begins anew.
    if (end > begin && time <= columns.time[(end - 1) & MASK]) clear();
    const slot = end & MASK;
    columns.time[slot] = time;
    for (const [name, channel] of Object.entries(CHANNELS)) if (channel.at) columns[name][slot] = view.getFloat32(at + channel.at, true);
    columns.residual[slot] = columns.displacement[slot] - columns.estimate[slot];
    columns.reference[slot] = inMillimetres && view.getUint8(at + 48) === RUNNING ? columns.set[slot] : NaN;
    notices[slot] = view.getUint32(at + 40, true);
    phases[slot] = view.getUint8(at + 48);
    faults[slot] = view.getUint8(at + 49);
    if (nth === count - 1) {
      store.late = view.getUint32(at + 12, true);
      store.longest = view.getUint32(at + 52, true);
    }
    end += 1;
    if (end - begin > SIZE) begin = end - SIZE;
  }
  store.hasEstimate = Number.isFinite(last("estimate"));
  const back = Math.max(begin, end - 2000);
  const span = lastTime() - columns.time[back & MASK];
  store.rate = span > 0 ? (end - 1 - back) / span : 0;
}

/** Index of the first sample at or after a time. */
function find(time) {
  let low = begin;
  let high = end;
  while (low < high) {
    const middle = Math.floor((low + high) / 2);
    if (columns.time[middle & MASK] < time) low = middle + 1;
    else high = middle;
  }
  return low;
}

const missing = (value) => (Number.isNaN(value) ? null : value);

/** Columns between two times for a plot, the time first. Where there are more samples than places, each place keeps the lowest and the highest. */
export function view(from, to, places, names) {
  const first = Math.max(begin, find(from) - 1);
  const after = Math.min(end, find(to) + 1);
  const stride = Math.max(1, Math.ceil((after - first) / places));
  const result = [[], ...names.map(() => [])];
  if (stride === 1) {
    for (let at = first; at < after; at++) {
      result[0].push(columns.time[at & MASK]);
      names.forEach((name, nth) => result[nth + 1].push(missing(columns[name][at & MASK])));
    }
    return result;
  }
  // Places stay where they are while time goes on: a plot must not shimmer.
  for (let place = Math.floor(first / stride) * stride; place < after; place += stride) {
    const low = Math.max(place, first);
    const high = Math.min(place + stride, after);
    if (high <= low) continue;
    result[0].push(columns.time[low & MASK], columns.time[(high - 1) & MASK]);
    names.forEach((name, nth) => {
      const column = columns[name];
      let smallest = Infinity;
      let largest = -Infinity;
      for (let at = low; at < high; at++) {
        const value = column[at & MASK];
        if (value < smallest) smallest = value;
        if (value > largest) largest = value;
      }
      const none = smallest > largest;
      // In the order in which they came, as far as two places can tell.
      const falls = column[low & MASK] > column[(high - 1) & MASK];
      result[nth + 1].push(none ? null : falls ? largest : smallest, none ? null : falls ? smallest : largest);
    });
  }
  return result;
}

/** Stretches of time with one of these notices, and moments at which a fault struck. */
export function marks(from, to, bits) {
  const stretches = [];
  const struck = [];
  let open = null;
  const after = Math.min(end, find(to) + 1);
  for (let at = Math.max(begin, find(from)); at < after; at++) {
    const slot = at & MASK;
    const marked = (notices[slot] & bits) !== 0;
    if (marked && open === null) open = columns.time[slot];
    if (!marked && open !== null) {
      stretches.push([open, columns.time[slot]]);
      open = null;
    }
    if (faults[slot] !== 0 && (at === begin || faults[(at - 1) & MASK] === 0)) struck.push([columns.time[slot], faults[slot]]);
  }
  if (open !== null) stretches.push([open, to]);
  return { stretches, struck };
}

/** Pairs of two channels since a time, at most so many, oldest first. */
export function pairs(x, y, since, most) {
  const first = Math.max(begin, find(since));
  const stride = Math.max(1, Math.ceil((end - first) / most));
  const result = [];
  for (let at = Math.ceil(first / stride) * stride; at < end; at += stride) {
    const slot = at & MASK;
    result.push([columns[x][slot], columns[y][slot], columns.time[slot]]);
  }
  return result;
}
