// Recordings, what is computed of them, models, and the drawer of the simulated rig.

import { $, act, download, make, mayConfigure, mayOperate, number, request, say } from "./elements.js";

let polling = null;
let recording = null;
let finished = 0;
let mostBytes = Infinity;
const chosen = new Set();

function stamp() {
  const now = new Date();
  const two = (value) => String(value).padStart(2, "0");
  return `run-${now.getFullYear()}${two(now.getMonth() + 1)}${two(now.getDate())}-${two(now.getHours())}${two(now.getMinutes())}${two(now.getSeconds())}`;
}

async function record() {
  if (recording) {
    const ended = await act("end-record");
    if (ended) say(`Recorded ${ended.recorded.samples} samples, ${number(ended.recorded.seconds, 1)} s.`);
    $("record-name").value = "";
    return refresh();
  }
  await act("record", { name: $("record-name").value || stamp(), note: $("record-note").value });
}

export function follow(state) {
  const before = recording?.name;
  recording = state.recording;
  $("record").textContent = recording ? "End recording" : "Record";
  $("record-progress").textContent = recording
    ? `${recording.name}: ${recording.samples} samples, ${number(recording.seconds, 1)} s${recording.left_out ? `, ${recording.left_out} left out` : ""}`
    : (state.remark ?? "");
  if (before && !recording) refresh();
  teach(state);
}

// What there is to say of a file that no recorder ended.
const WHY = {
  interrupted: "Nobody ended it; its last row may be cut.",
  foreign: "Not recorded on this page.",
};

async function list() {
  const { folder, most_bytes: most, recordings } = await request("GET", "/api/recordings");
  mostBytes = most;
  $("recordings-folder").textContent = `In ${folder}`;
  $("recordings").replaceChildren(...recordings.map(({ name, state, about }) => make("tr", {},
    make("td", {}, make("input", { type: "checkbox", "aria-label": `Use ${name}`, checked: chosen.has(name),
      onchange: (event) => (event.target.checked ? chosen.add(name) : chosen.delete(name)) })),
    make("td", {}, name, about?.note || WHY[state] ? make("span", { class: "hint" }, about?.note || WHY[state]) : null),
    make("td", { class: "number" }, about ? `${number(about.seconds, 1)} s` : state),
    make("td", { class: "number" }, about ? String(about.samples) : ""),
    make("td", {}, make("button", { type: "button", "aria-label": `Save ${name} as a file`,
      onclick: async () => download(`${name}.csv`, await request("GET", `/api/recordings/${name}`), "text/csv") }, "CSV")))));
}

async function jobs() {
  const { kinds, jobs: all } = await request("GET", "/api/jobs");
  if (!$("jobs-kinds").childElementCount) {
    $("jobs-kinds").append(...kinds.map(([kind, title]) => make("button", { type: "button", disabled: !mayOperate(), onclick: async () => {
      try {
        await request("POST", "/api/jobs", { kind, recordings: [...chosen] });
      } catch (problem) {
        say(problem.message, true);
      }
      jobs();
    } }, title)));
  }
  const last = all.at(-1);
  $("job-end").hidden = !last?.running;
  if (last) {
    const how = last.running ? "running" : last.exit_code === 0 ? "done" : last.exit_code === null ? "ended" : `exit code ${last.exit_code}`;
    $("job-title").textContent = `${last.kind} of ${last.recordings.join(", ")}: ${how}`;
    const log = $("job-lines");
    log.hidden = false;
    log.textContent = last.lines.join("\n");
    log.scrollTop = log.scrollHeight;
    const report = $("job-report");
    report.hidden = !last.report;
    if (last.report && report.getAttribute("src") !== last.report) report.src = last.report;
    $("job-use").hidden = !last.model;
    $("job-use").disabled = !mayConfigure();
    finished = last.number;
  }
  clearTimeout(polling);
  if (last?.running) polling = setTimeout(() => jobs().catch(() => null), 700);
}

/** The model of the last computation goes to the device, with the settings that belong to it. */
async function use() {
  try {
    const { model_id: id } = await request("POST", `/api/jobs/${finished}/use`);
    say(`The device checked the model and uses it: ${id}. Its estimate is drawn beside the laser.`);
  } catch (problem) {
    say(problem.message, true);
  }
}

async function upload(event) {
  const file = event.target.files[0];
  if (!file) return;
  try {
    const { model_id: id } = await request("POST", "/api/model", await file.arrayBuffer());
    say(`The device checked the model and uses it: ${id}.`);
  } catch (problem) {
    say(problem.message, true);
  }
  event.target.value = "";
}

/** The name of a recording for a file: without its ending, with letters that a name has. */
const nameOf = (file) => file.replace(/(\.(csv|tsv|dat|txt|npz|mat|mcap))?(\.gz)?$/i, "").replace(/[^A-Za-z0-9_.-]+/g, "-").replace(/^\.+/, "").slice(0, 80) || "loaded";

/** Recordings that somebody has: read by the server as every command reads them, then chosen like one made just now. */
async function load(event) {
  const said = [];
  let refused = false;
  for (const file of event.target.files) {
    const name = nameOf(file.name);
    try {
      if (file.size > mostBytes) throw new Error(`${file.name} has more than ${number(mostBytes / 2 ** 20, 0)} MB; put it into the folder.`);
      const query = new URLSearchParams({ file: file.name, columns: $("load-columns").value.trim() });
      const loaded = await request("POST", `/api/recordings/${name}?${query}`, await file.arrayBuffer());
      chosen.add(name);
      said.push(`${name}: ${loaded.samples} samples, ${number(loaded.seconds, 1)} s.`, ...loaded.notes);
    } catch (problem) {
      refused = true;
      said.push(problem.message);
    }
  }
  event.target.value = "";
  $("load-said").textContent = said.join("\n");
  $("load-said").classList.toggle("problem", refused);
  await refresh();
}

export const refresh = () => Promise.all([list(), jobs()]).catch((problem) => say(problem.message, true));

let taught = "";

function teach({ identity, rig }) {
  $("tab-teach").hidden = !identity?.simulated;
  const key = JSON.stringify([identity?.plants, identity?.faults, rig?.injected, rig?.plant]);
  if (!identity?.simulated || key === taught) return;
  taught = key;
  const chip = (title, pressed, does) => make("button", { type: "button", "aria-pressed": String(pressed), onclick: does }, title);
  $("teach-plants").replaceChildren(...identity.plants.map(({ name, title }) => chip(title, rig?.plant === name, () => act("plant", { name }))));
  $("teach-faults").replaceChildren(
    chip("Nothing is broken", !rig?.injected, () => act("inject", {})),
    ...identity.faults.map(({ name, title }) => chip(title, rig?.injected === name, () => act("inject", { fault: name }))));
}

export function start() {
  $("page-learn").append(
    make("div", { class: "form" },
      make("label", {}, "Name", make("input", { id: "record-name", pattern: "[A-Za-z0-9_.\\-]*", maxlength: 80, placeholder: "named by the time", class: "short" })),
      make("label", { class: "wide" }, "Note", make("input", { id: "record-note", maxlength: 500 })),
      make("button", { id: "record", type: "button", class: "main", onclick: record }, "Record")),
    make("p", { id: "record-progress", class: "hint row", role: "status" }),
    make("h3", {}, "Recordings"),
    make("p", { id: "recordings-folder", class: "hint" }),
    make("table", {}, make("thead", {}, make("tr", {}, make("th", { scope: "col" }, "Use"), make("th", { scope: "col" }, "Name"),
      make("th", { scope: "col", class: "number" }, "Length"), make("th", { scope: "col", class: "number" }, "Samples"), make("th", { scope: "col" }, "File"))),
    make("tbody", { id: "recordings" })),
    make("div", { class: "form row" },
      make("label", { class: "wide" }, "Load recordings that you have", make("input", { id: "load-file", type: "file", multiple: true, disabled: true,
        accept: ".csv,.tsv,.dat,.txt,.gz,.npz,.mat,.mcap", onchange: load })),
      make("label", { class: "wide" }, "Their columns, if they have other names", make("input", { id: "load-columns", maxlength: 2000,
        placeholder: "time=t:ms,input=P:kPa,output=laser:um" }))),
    make("p", { id: "load-said", class: "hint said-lines", role: "status" }),
    make("div", { class: "row", id: "jobs-kinds" }),
    make("div", { class: "row" }, make("span", { id: "job-title", role: "status" }),
      make("button", { id: "job-end", type: "button", hidden: true, onclick: () => request("DELETE", "/api/jobs").catch(() => null) }, "End it"),
      make("button", { id: "job-use", type: "button", class: "main", hidden: true, onclick: use }, "Use on the device")),
    make("pre", { id: "job-lines", class: "lines", hidden: true, tabindex: 0, "aria-label": "What the computation says" }),
    make("iframe", { id: "job-report", title: "Report", hidden: true }),
    make("h3", {}, "Model"),
    make("label", { class: "row" }, "Upload a blob, which the device checks and then uses: ",
      make("input", { id: "model-file", type: "file", accept: ".blob", disabled: !mayConfigure(), onchange: upload })));
  $("page-teach").append(
    make("p", { class: "hint" }, "This rig is simulated. Break it, or hide an effect in it, and see what the device notices and what discovery finds."),
    make("h3", {}, "What moves the tip"), make("div", { id: "teach-plants", class: "chips row" }),
    make("h3", {}, "What is broken"), make("div", { id: "teach-faults", class: "chips row" }));
}
