// Keys and game pad of the page that leads, and its heartbeat: a page that draws no more falls silent.
"use strict";
(() => {
  const BEAT_MS = 100, COMMAND_MS = 40, DRAWN_MS = 800, DEAD_ZONE = 0.15;
  // Axis and sense of a key: metres along x, y, z, then turns about them.
  const KEYS = {
    KeyW: [0, 1], KeyS: [0, -1], KeyA: [1, 1], KeyD: [1, -1], KeyR: [2, 1], KeyF: [2, -1],
    KeyU: [3, 1], KeyO: [3, -1], KeyI: [4, 1], KeyK: [4, -1], KeyJ: [5, 1], KeyL: [5, -1],
  };
  const down = new Set();
  let socket = null, drawn = performance.now(), said = 0, moved = false, held = false;

  const token = () => document.querySelector("[data-coopqp-lead]")?.dataset.coopqpLead;
  const writes = (element) => ["TEXTAREA", "SELECT"].includes(element?.tagName) ||
    (element?.tagName === "INPUT" && !["range", "checkbox", "button"].includes(element.type));

  function connect() {
    socket = new WebSocket(location.href.split(/[?#]/)[0].replace(/^http/, "ws").replace(/\/$/, "") + "/coopqp");
    socket.onclose = () => setTimeout(connect, 500);
  }

  function key(event) {
    const ours = event.code in KEYS || event.code === "Space";
    if (!ours || event.ctrlKey || event.altKey || event.metaKey || !token() || writes(event.target)) return;
    event.preventDefault();
    event.stopImmediatePropagation();  // viser's camera has keys of its own
    if (event.type === "keyup") { down.delete(event.code); }
    else if (event.code === "Space") { if (!event.repeat) say({call: "pause"}); return; }
    else { down.add(event.code); }
    tell();
  }

  function twist() {
    const v = [0, 0, 0, 0, 0, 0];
    for (const code of down) { const [axis, sense] = KEYS[code]; v[axis] += sense; }
    const pad = [...(navigator.getGamepads?.() ?? [])].find((p) => p?.connected && p.mapping === "standard");
    if (pad) {
      const axis = (i) => Math.abs(pad.axes[i] ?? 0) > DEAD_ZONE ? pad.axes[i] : 0;
      const button = (i) => pad.buttons[i]?.value ?? 0;
      const more = [-axis(1), -axis(0), button(7) - button(6), button(5) - button(4), -axis(3), -axis(2)];
      more.forEach((x, i) => { v[i] += x; });
      const pressed = pad.buttons[1]?.pressed ?? false;
      if (pressed && !held) say({call: "pause"});
      held = pressed;
    }
    return v.map((x) => Math.max(-1, Math.min(1, x)));
  }

  function say(more) {
    const mine = token();
    if (!mine || socket?.readyState !== WebSocket.OPEN) return;
    said = performance.now();
    socket.send(JSON.stringify({token: mine, ...more}));
  }

  function tell() {
    const now = performance.now(), v = twist(), moves = v.some((x) => x !== 0);
    if (now - drawn > DRAWN_MS) return;
    if (moves || moved) say({twist: v});
    else if (now - said >= BEAT_MS) say({});
    moved = moves;
  }

  const draws = () => { drawn = performance.now(); requestAnimationFrame(draws); };
  for (const kind of ["keydown", "keyup"]) window.addEventListener(kind, key, true);
  for (const kind of ["blur", "visibilitychange"]) window.addEventListener(kind, () => down.clear());
  requestAnimationFrame(draws);
  setInterval(tell, COMMAND_MS);
  connect();
})();
