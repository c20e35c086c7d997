// Ticks of a worker: a browser slows the timers of a page that is not in front, and the heartbeat must not slow down. What is sent is still the
// page's own word: one that hangs is silent.
setInterval(() => postMessage(0), 50);
