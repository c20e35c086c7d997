// The live connection: samples and state come in, heartbeats and the vent go out.

import { self } from "./elements.js";

const listeners = { state: [], samples: [], hello: [], closed: [], missed: [] };
let socket = null;
let wait = 250;
let holds = false;
let beats = 0;
let frame = null;
let heard = 0;
export const link = { missed: 0, open: false };

// The server sends the state every 200 ms. A network that is cut closes no connection: only the silence tells.
const SILENCE_MS = 2000;

export const on = (what, does) => listeners[what].push(does);
const tell = (what, ...values) => listeners[what].forEach((does) => does(...values));

function send(word) {
  if (socket?.readyState !== WebSocket.OPEN) return false;
  socket.send(word);
  return true;
}

export const take = () => send("take");
export const release = () => send("release");

/** Vents by both ways: the connection may be gone without anybody knowing. */
export function vent() {
  send("vent");
  const headers = { Authorization: `Bearer ${self.token}`, "Content-Type": "application/json" };
  return fetch("/api/act", { method: "POST", headers, body: '{"do":"vent"}', keepalive: true }).catch(() => null);
}

export function connect() {
  const scheme = location.protocol === "https:" ? "wss" : "ws";
  socket = new WebSocket(`${scheme}://${location.host}/live`, ["catheter.1", `token.${self.token}`]);
  socket.binaryType = "arraybuffer";
  socket.onmessage = (event) => {
    heard = performance.now();
    if (typeof event.data === "string") word(JSON.parse(event.data));
    else samples(event.data);
  };
  socket.onclose = lost;
}

function lost() {
  link.open = holds = false;
  self.client = null;
  tell("closed");
  setTimeout(connect, wait);
  wait = Math.min(wait * 2, 4000);
}

/** Gives up a connection on which nothing arrives; a close without an answer would take the browser a minute. */
function giveUp() {
  socket.onmessage = socket.onclose = null;
  socket.close();
  lost();
}

function word(value) {
  if (value.kind === "hello") {
    wait = 250;
    link.open = true;
    frame = null;
    Object.assign(self, { client: value.client, number: value.number, role: value.role });
    tell("hello");
  } else if (value.kind === "state") {
    holds = value.lease?.client === self.number;
    tell("state", value);
  } else if (value.kind === "missed") {
    link.missed += value.frames;
    frame = null;
  }
}

function samples(data) {
  const view = new DataView(data);
  const number = view.getUint32(4, true);
  // Frames of what is past all carry the number of the last one before it.
  if (frame !== null && number > frame + 1) link.missed += number - frame - 1;
  frame = number;
  tell("samples", view, view.getUint16(2, true), view.getUint32(8, true), view.getFloat32(12, true));
}

const worker = new Worker("/assets/beat.js");
worker.onmessage = () => {
  beats += 1;
  if (link.open && performance.now() - heard > SILENCE_MS) giveUp();
  if (holds) send("beat");
  else if (beats % 40 === 0) send("here");
};
