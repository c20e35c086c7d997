// The live connection: samples and state come in, heartbeats and the vent go out.

import { self } from "./elements.js";

const listeners = { state: [], samples: [], hello: [], closed: [], missed: [] };
let socket = null;
let wait = 250;
let holds = false;
let beats = 0;
let frame = null;
export const link = { missed: 0, open: false };

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
    if (typeof event.data === "string") word(JSON.parse(event.data));
    else samples(event.data);
  };
  socket.onclose = () => {
    link.open = holds = false;
    self.client = null;
    tell("closed");
    setTimeout(connect, wait);
    wait = Math.min(wait * 2, 4000);
  };
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
  if (holds) send("beat");
  else if (beats % 40 === 0) send("here");
};
