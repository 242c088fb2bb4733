"use strict";
for (const figure of document.querySelectorAll("figure.motion")) {
  const frames = Number(figure.dataset.frames), rate = Number(figure.dataset.rate), start = Number(figure.dataset.start);
  const lines = [...figure.querySelectorAll("[data-points]")].map((line) => {
    const points = line.dataset.points.split(" ");
    const shape = line.classList[0], measured = line.classList.contains("measured");
    return {line, points, each: points.length / frames, tail: Number(line.dataset.tail), shape, measured};
  });
  // every line of a model beside the same line as it was measured
  const order = new Map();
  for (const one of lines) {
    const key = one.shape + one.line.getAttribute("class"), place = order.get(key) ?? 0;
    order.set(key, place + 1);
    one.beside = one.measured ? null : lines.filter((other) => other.measured && other.shape === one.shape)[place] ?? null;
  }
  const cursor = figure.querySelector(".cursor");
  const left = Number(cursor.dataset.left), width = Number(cursor.dataset.right) - left;
  const make = (name, settings) => Object.assign(document.createElement(name), settings);
  const button = make("button", {type: "button"});
  const slider = make("input", {type: "range", min: 0, max: frames - 1, step: 1});
  const speed = make("select", {});
  for (const one of [0.1, 0.25, 0.5, 1, 2]) speed.add(new Option(one + " ×", one, one === 1, one === 1));
  const clock = make("span", {className: "clock"});
  const ENLARGED = 10, large = make("input", {type: "checkbox"}), enlarge = make("label", {className: "enlarge"});
  enlarge.append(large, ` gap × ${ENLARGED}`);
  const pick = ({points, beside}, from, to) => {
    const own = points.slice(from, to);
    if (!large.checked || !beside) return own.join(" ");
    const base = beside.points.slice(from, to);
    return own.map((value, k) => Number(base[k]) + ENLARGED * (value - base[k])).join(" ");
  };
  slider.setAttribute("aria-label", "time");
  speed.setAttribute("aria-label", "speed");
  let at = Number(figure.dataset.still), before = null, asked = 0;

  function show() {
    const frame = Math.min(Math.floor(at), frames - 1);
    for (const one of lines)
      one.line.setAttribute("points", pick(one, Math.max(0, frame - one.tail) * one.each, (frame + 1) * one.each));
    cursor.setAttribute("transform", `translate(${left + width * frame / (frames - 1)} 0)`);
    clock.textContent = (start + frame / rate).toFixed(2) + " s";
    slider.value = frame;
    slider.setAttribute("aria-valuetext", clock.textContent);
  }
  function step(now) {
    if (before !== null) at += (now - before) / 1000 * rate * Number(speed.value);
    if (at >= frames) at = 0;
    before = now;
    show();
    asked = requestAnimationFrame(step);
  }
  function play(playing) {
    cancelAnimationFrame(asked);
    before = null;
    asked = playing ? requestAnimationFrame(step) : 0;
    button.textContent = playing ? "Pause" : "Play";
  }
  button.addEventListener("click", () => play(asked === 0));
  slider.addEventListener("input", () => { play(false); at = Number(slider.value); show(); });
  const controls = make("div", {className: "controls"});
  large.addEventListener("change", show);
  controls.append(button, slider, clock, speed, enlarge);
  figure.querySelector(".stage").after(controls);
  play(false);
  show();
}
