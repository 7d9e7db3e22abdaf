(() => {
  const panel = document.getElementById("coopqp-panel"), data = JSON.parse(document.getElementById("coopqp-moments").textContent);
  const slot = name => panel.querySelectorAll(`[data-slot="${name}"]`);
  const bars = panel.querySelectorAll(".coopqp-bar"), values = slot("value");
  let shown = -1;
  const show = i => {
    if (i === shown) return;
    shown = i;
    const m = data.moments[i];
    document.documentElement.style.setProperty("--coopqp-at", m.at);
    slot("clock")[0].textContent = m.clock;
    slot("status")[0].textContent = data.statuses[m.status][0];
    slot("colour")[0].style.background = data.statuses[m.status][1];
    slot("why")[0].textContent = document.getElementById("coopqp-line").textContent = data.why[m.why];
    m.values.forEach((text, k) => { values[k].textContent = text; });
    m.joints.forEach((place, k) => { bars[k].style.setProperty("--p", place / 100); });
    bars.forEach((bar, k) => bar.classList.toggle("coopqp-bound", m.bound.includes(k)));
  };
  const thumb = () => document.querySelector("[role=slider]");
  const follow = () => {
    const now = thumb();
    if (now) {
      const seconds = Math.min(Number(now.getAttribute("aria-valuenow")) || 0, data.end);
      show(Math.floor(seconds / data.end * (data.moments.length - 1) + 1e-3));
    }
    requestAnimationFrame(follow);
  };
  const seek = (plot, x) => {
    const box = plot.getBoundingClientRect(), share = Math.min(Math.max((x - box.left) / box.width, 0), 1);
    const track = document.querySelector("[class*=Slider-trackContainer]");
    if (!track) return;
    const to = track.getBoundingClientRect(), last = Number(thumb().getAttribute("aria-valuemax")) || data.end;
    const where = {bubbles: true, cancelable: true, button: 0, clientX: to.left + to.width * share * data.end / last,
      clientY: to.top + to.height / 2};
    track.dispatchEvent(new MouseEvent("mousedown", where));
    document.dispatchEvent(new MouseEvent("mouseup", where));
  };
  panel.querySelectorAll(".coopqp-plot").forEach(plot => {
    plot.addEventListener("pointerdown", e => { plot.setPointerCapture(e.pointerId); seek(plot, e.clientX); });
    plot.addEventListener("pointermove", e => { if (e.buttons) seek(plot, e.clientX); });
  });
  const toggle = document.getElementById("coopqp-toggle");
  const open = yes => {
    document.documentElement.classList.toggle("coopqp-open", yes);
    toggle.setAttribute("aria-expanded", yes);
    toggle.textContent = yes ? "hide" : "plots";
  };
  toggle.addEventListener("click", () => open(!document.documentElement.classList.contains("coopqp-open")));
  open(window.innerWidth >= 900);
  follow();
})();
