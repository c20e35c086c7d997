// Elements, words and requests that every part of the page uses.

export const $ = (id) => document.getElementById(id);

/** An element with attributes and children; `on...` attributes are listeners. */
export function make(tag, attributes = {}, ...children) {
  const element = document.createElement(tag);
  for (const [name, value] of Object.entries(attributes)) {
    if (name.startsWith("on")) element.addEventListener(name.slice(2), value);
    else if (value === true) element.setAttribute(name, "");
    else if (value !== false && value !== null && value !== undefined) element.setAttribute(name, value);
  }
  element.append(...children.flat().filter((child) => child !== null && child !== undefined));
  return element;
}

/** Who this page is: the token from its address, kept for this tab alone, and the secret of its connection. */
export const self = { token: token(), client: null, number: 0, role: "observe" };

function token() {
  const given = new URLSearchParams(location.search).get("token");
  if (given) {
    sessionStorage.setItem("token", given);
    // Not in the history, nor in a screenshot of the address bar.
    history.replaceState(null, "", location.pathname);
  }
  return given ?? sessionStorage.getItem("token") ?? "";
}

/** A request; a refusal is an error with the server's reason. */
export async function request(method, path, body) {
  const headers = { Authorization: `Bearer ${self.token}` };
  if (self.client) headers["X-Lease"] = self.client;
  const raw = body instanceof ArrayBuffer;
  if (body !== undefined && !raw) headers["Content-Type"] = "application/json";
  const answer = await fetch(path, { method, headers, body: body === undefined || raw ? body : JSON.stringify(body) });
  const text = await answer.text();
  let value = null;
  try { value = JSON.parse(text); } catch { /* Some refusals are plain text. */ }
  if (!answer.ok) throw new Error(value?.error ?? (text || answer.statusText));
  return value ?? text;
}

/** Does something to the rig; a refusal is said. */
export async function act(action, values = {}) {
  try {
    return await request("POST", "/api/act", { do: action, ...values });
  } catch (problem) {
    say(problem.message, true);
    return null;
  }
}

/** Says something at the bottom for a while. */
export function say(text, bad = false) {
  const line = make("p", { class: bad ? "bad" : null }, text);
  $("said").append(line);
  setTimeout(() => line.remove(), bad ? 9000 : 4000);
}

export function number(value, digits) {
  if (!Number.isFinite(value)) return "–";
  // A sign before zeros would flicker.
  return (Math.abs(value) < 0.5 * 10 ** -digits ? 0 : value).toFixed(digits);
}

export const colour = (name) => getComputedStyle(document.documentElement).getPropertyValue(`--${name}`).trim();

export const mayConfigure = () => self.role === "configure";
export const mayOperate = () => self.role !== "observe";

/** A file for the user to keep. */
export function download(name, text, type) {
  const link = make("a", { href: URL.createObjectURL(new Blob([text], { type })), download: name });
  link.click();
  setTimeout(() => URL.revokeObjectURL(link.href), 1000);
}
