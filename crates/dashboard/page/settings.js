// Settings: searched, with units and bounds, what differs from the saved ones marked, and each way back.

import { $, act, make, mayConfigure, request, say } from "./elements.js";

let settings = [];

const text = (value) => String(value);

async function put(setting, value) {
  if (await act("set", { name: setting.name, value })) say(`${setting.name} = ${text(value)} ${setting.unit}`);
  await refresh();
}

function editor(setting) {
  const label = { "aria-label": `${setting.name}, ${setting.meaning}`, disabled: !mayConfigure() };
  if (typeof setting.value === "boolean") {
    return make("input", { type: "checkbox", checked: setting.value, ...label, onchange: (event) => put(setting, event.target.checked) });
  }
  const whole = Number.isInteger(setting.minimum) && Number.isInteger(setting.maximum) && Number.isInteger(setting.default) && !setting.unit.includes("/");
  return make("input", {
    type: "number", value: text(setting.value), min: text(setting.minimum), max: text(setting.maximum), step: "any", inputmode: whole ? "numeric" : "decimal",
    ...label,
    onchange: (event) => (event.target.checkValidity() ? put(setting, Number(event.target.value)) : event.target.reportValidity()),
  });
}

function row(setting) {
  const changed = setting.value !== setting.saved;
  return make("tr", { class: changed ? "changed" : null },
    make("td", {}, setting.name, make("span", { class: "hint" }, setting.meaning)),
    make("td", { class: "value" }, editor(setting), " ", setting.unit),
    make("td", { class: "number" }, typeof setting.value === "boolean" ? "" : `${text(setting.minimum)} to ${text(setting.maximum)}`),
    make("td", { class: "number" }, changed ? `saved ${text(setting.saved)}` : setting.value !== setting.default ? `default ${text(setting.default)}` : ""),
    make("td", {}, changed && mayConfigure()
      ? make("button", { type: "button", onclick: () => put(setting, setting.saved), "aria-label": `Revert ${setting.name}` }, "Revert") : null));
}

function show() {
  const wanted = $("settings-search").value.toLowerCase().split(/\s+/).filter(Boolean);
  const differing = $("settings-changed").checked;
  const shown = settings.filter((setting) => {
    const all = `${setting.name} ${setting.meaning} ${setting.unit}`.toLowerCase();
    return wanted.every((word) => all.includes(word)) && (!differing || setting.value !== setting.saved);
  });
  const rows = [];
  let group = "";
  for (const setting of shown) {
    const own = setting.name.split(".")[0];
    if (own !== group) rows.push(make("tr", { class: "group" }, make("th", { colspan: 5, scope: "rowgroup" }, (group = own))));
    rows.push(row(setting));
  }
  $("settings-rows").replaceChildren(...rows);
  const changed = settings.filter((setting) => setting.value !== setting.saved).length;
  $("settings-count").textContent = `${shown.length} of ${settings.length} settings; ${changed} differ from the saved ones.`;
  $("settings-save").disabled = $("settings-revert").disabled = !mayConfigure() || changed === 0;
}

export async function refresh() {
  try {
    settings = (await request("GET", "/api/settings")).settings;
    show();
  } catch (problem) {
    $("settings-count").textContent = problem.message;
  }
}

export function start() {
  const then = (action, words) => async () => {
    if (await act(action)) say(words);
    await refresh();
  };
  $("page-settings").append(
    make("div", { class: "form" },
      make("label", { class: "wide" }, "Search", make("input", { id: "settings-search", type: "search", oninput: show, placeholder: "pressure, timeout, pid …" })),
      make("label", {}, "Only those that differ", make("input", { id: "settings-changed", type: "checkbox", onchange: show })),
      make("button", { id: "settings-save", type: "button", class: "main", onclick: then("save", "Saved: the device starts with these settings from now on.") }, "Save to flash"),
      make("button", { id: "settings-revert", type: "button", onclick: then("revert", "The saved settings are in use.") }, "Revert all")),
    make("p", { id: "settings-count", class: "hint row", role: "status" }),
    make("div", { class: "scroll" }, make("table", {},
      make("thead", {}, make("tr", {}, ...["Setting", "In use", "Bounds", "", ""].map((name, nth) => make("th", { scope: "col", class: nth > 1 ? "number" : null }, name)))),
      make("tbody", { id: "settings-rows" }))));
}
