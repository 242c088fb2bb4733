"use strict";
// All samples: plots with one time axis and one cursor. What a recording holds is unpacked when it is first drawn.
(() => {
  const section = document.getElementById("samples");
  if (!section || typeof DecompressionStream === "undefined") return;
  const plan = JSON.parse(section.dataset.plan), root = section.querySelector(".plots");
  const TALL = 190, LOW = 110, AXIS = 24, GUTTER = 58, FEWEST = 8, MARGIN = 0.25;
  let recording = null, time = [], view = [0, 1], bands = [], colours = {};
  const off = new Set(Object.keys(plan.kinds).filter((kind) => plan.kinds[kind].off));

  const make = (name, settings, ...children) => {
    const {attributes = {}, ...own} = settings, made = Object.assign(document.createElement(name), own);
    for (const [key, value] of Object.entries(attributes)) made.setAttribute(key, value);
    made.append(...children);
    return made;
  };
  const colour = (role) =>
    colours[role] ??= getComputedStyle(document.documentElement).getPropertyValue("--" + role).trim();
  const signed = (text) => text.replace("-", "−");

  // ---- samples ---------------------------------------------------------------------------------------------------
  const kept = new Map();
  function once(id, unpack) {
    if (!kept.has(id)) kept.set(id, numbers(id).then(unpack));
    return kept.get(id);
  }
  async function numbers(id) {
    const node = document.getElementById(id);
    const bytes = Uint8Array.from(atob(node.textContent), (letter) => letter.charCodeAt(0));
    const stream = new Blob([bytes]).stream().pipeThrough(new DecompressionStream("deflate"));
    const planes = new Uint8Array(await new Response(stream).arrayBuffer()), count = planes.length / 4;
    const whole = new Int32Array(count);
    for (let k = 0, last = 0; k < count; k++) {
      const folded = planes[k] | planes[count + k] << 8 | planes[2 * count + k] << 16 | planes[3 * count + k] << 24;
      whole[k] = last += folded >>> 1 ^ -(folded & 1);
    }
    return {whole, offset: Number(node.dataset.offset), step: Number(node.dataset.step)};
  }
  const timesOf = (number) => once(`samples-${number}-time`, ({whole, offset, step}) => {
    let ticks = 0;
    return Float64Array.from(whole, (k) => offset + step * (ticks += k));
  });
  const traceOf = (number, plot, kind) => once(`samples-${number}-${plot}-${kind}`, ({whole, offset, step}) => ({
    values: whole.includes(-1) ? Array.from(whole, (k) => k < 0 ? null : offset + step * k) :
      Float64Array.from(whole, (k) => offset + step * k),
    digits: Math.min(12, Math.max(0, Math.ceil(-Math.log10(step)))),
  }));
  function difference(a, b) {
    const found = Array.isArray(a) || Array.isArray(b) ? new Array(a.length) : new Float64Array(a.length);
    for (let k = 0; k < a.length; k++) found[k] = a[k] === null || b[k] === null ? null : a[k] - b[k];
    return found;
  }

  // ---- panels: the traces of a plot, and below them what its models are off by --------------------------------------
  const panels = plan.plots.flatMap((plot, number) => {
    const models = plot.kinds.filter((kind) => kind !== "measured");
    const own = {plot, number, kinds: plot.kinds, errors: false, height: plot.modelled ? TALL : LOW};
    return plot.modelled ? [own, {plot, number, kinds: models, errors: true, height: LOW}] : [own];
  });
  for (const panel of panels) {
    const {plot, errors, kinds} = panel;
    const title = `${errors ? "measured − model" : plot.name} [${plot.unit || "-"}]`;
    panel.last = errors || !plot.modelled;
    panel.values = kinds.map(() => make("output", {value: "–"}));
    panel.keys = kinds.map((kind, k) => make("span", {className: "key", title: plan.kinds[kind].name},
      ...(plot.modelled ? [swatch(kind)] : []), panel.values[k]));
    panel.canvas = make("div", {className: "canvas", tabIndex: 0, attributes: {
      role: "img", "aria-label": `${errors ? plot.name + ", " : ""}${title} over time [s]`}});
    panel.box = make("div", {className: errors ? "panel errors" : "panel"},
      make("div", {className: "head"}, make("b", {textContent: title}), ...panel.keys), panel.canvas);
    panel.canvas.style.height = `${panel.height + (panel.last ? AXIS : 0)}px`;
    panel.box.dataset.column = plot.column;
  }
  function swatch(kind) {
    const [picture, line] = ["svg", "path"].map((name) => document.createElementNS("http://www.w3.org/2000/svg", name));
    const {role, dash} = plan.kinds[kind];
    picture.setAttribute("viewBox", "0 0 22 8");
    picture.setAttribute("aria-hidden", "true");
    picture.setAttribute("class", `swatch ${role}`);
    line.setAttribute("d", "M1 4H21");
    line.setAttribute("stroke-dasharray", dash.join(" "));
    picture.append(line);
    return picture;
  }

  async function fill(panel) {
    const {number} = recording;
    const traces = await Promise.all(panel.plot.kinds.map((kind) => traceOf(number, panel.number, kind)));
    if (number !== recording.number) return;
    panel.digits = Math.max(...traces.map((one) => one.digits));
    const values = traces.map((one) => one.values);
    const data = [time, ...(panel.errors ? values.slice(1).map((one) => difference(values[0], one)) : values)];
    if (panel.chart) panel.chart.setData(data, false);
    else build(panel, data);
    fit(panel);
  }
  function build(panel, data) {
    const {plot, kinds, last} = panel;
    const axis = {stroke: () => colour("muted"), font: "12px system-ui, sans-serif", ticks: {show: false},
      grid: {stroke: () => colour("line"), width: 1}};
    panel.chart = new uPlot({
      width: panel.canvas.clientWidth, height: panel.canvas.clientHeight, padding: [6, 18, last ? 0 : 6, 0],
      scales: {x: {time: false}, y: {range: (_, low, high) => roomy(low, high)}},
      legend: {show: false},
      cursor: {y: false, points: {size: 7, width: 1.5, fill: () => colour("paper"),
          stroke: (_, k) => colour(plan.kinds[kinds[k - 1]].role)},
        drag: {x: true, y: false, setScale: false},
        sync: {key: "pamid", filters: {pub: (kind) => kind === "mousemove" || kind === "mouseleave"}},
        bind: {dblclick: () => () => { all(); return null; }}},
      axes: [
        {...axis, show: last, size: AXIS, values: (_, ticks) => ticks.map((t) => `${+t.toFixed(6)} s`)},
        {...axis, size: GUTTER, space: 26, values: (_, ticks) => ticks.map((y) => signed(`${+y.toPrecision(9)}`))},
      ],
      series: [{}, ...kinds.map((kind) => ({
        show: !off.has(kind), dash: plan.kinds[kind].dash, width: kind === "measured" && plot.modelled ? 1.8 : 1.3,
        stroke: () => colour(plan.kinds[kind].role), paths: plot.modelled ? undefined : uPlot.paths.stepped({align: 1}),
        points: {size: 4, fill: () => colour("paper")},
      }))],
      hooks: {
        drawClear: [(chart) => backdrop(chart, panel)],
        setSelect: [(chart) => {
          const {left, width} = chart.select;
          if (width > 2) show(chart.posToVal(left, "x"), chart.posToVal(left + width, "x"));
          chart.setSelect({left: 0, top: 0, width: 0, height: 0}, false);
        }],
        setCursor: [(chart) => tell(chart, panel)],
      },
    }, data, panel.canvas);
    panel.chart.over.addEventListener("mousedown", () => panel.canvas.focus({preventScroll: true}));
    gestures(panel);
  }
  function roomy(low, high) {
    if (low === null || high === null) return [0, 1];
    const room = 0.06 * (high - low) || Math.abs(high) || 1;
    return [low - room, high + room];
  }
  /** The values at the cursor, in this panel's head. */
  function tell(chart, panel) {
    const {idx, left} = chart.cursor, blank = idx === null || idx === undefined || left < 0;
    panel.box.classList.toggle("read", !blank);
    panel.values.forEach((output, k) => {
      const y = blank ? null : chart.data[k + 1][idx];
      output.value = y === null || y === undefined ? "–" : signed(y.toFixed(panel.digits));
    });
    if (!blank) clock.value = `${+time[idx].toFixed(6)} s`;
  }
  /** Behind the lines: bands that are meant, what was not scored, edges of windows, what was held out, zero. */
  function backdrop(chart, panel) {
    const {ctx} = chart, {left, top, width, height} = chart.bbox, ratio = devicePixelRatio;
    const at = (t) => Math.min(left + width, Math.max(left, chart.valToPos(t, "x", true)));
    const fill = (from, to, role, alpha, tall = height) => {
      ctx.globalAlpha = alpha;
      ctx.fillStyle = colour(role);
      ctx.fillRect(at(from), top, Math.max(at(to) - at(from), ratio), tall);
    };
    const inside = ([from, to]) => to >= view[0] && from <= view[1];
    ctx.save();
    for (const band of bands) if (inside(band)) fill(...band, "with-cause", 0.14);
    recording.windows.forEach(([first, last, held], k, every) => {
      const begin = k ? time[every[k - 1][1]] : time[0];
      if (!inside([begin, time[last]])) return;
      if (held) fill(begin, time[last], "muted", 0.8, 3 * ratio);
      if (at(time[last]) - at(begin) < 30 * ratio) return;
      fill(begin, time[first], "noise-floor", 0.25);
      fill(begin, begin, "muted", 0.6);
    });
    if (panel.errors && chart.scales.y.min < 0 && chart.scales.y.max > 0) {
      ctx.globalAlpha = 0.7;
      ctx.fillStyle = colour("muted");
      ctx.fillRect(left, Math.round(chart.valToPos(0, "y", true)), width, ratio);
    }
    ctx.restore();
  }

  // ---- what is shown ---------------------------------------------------------------------------------------------
  function fit(panel) {
    panel.state = [recording.number, ...view].join();
    panel.chart.setScale("x", {min: view[0], max: view[1]});
  }
  /** Bring every panel that can be seen to the recording and the times that are shown. */
  function refresh() {
    const state = [recording.number, ...view].join();
    return Promise.all(panels.filter((panel) => panel.near && panel.state !== state).map((panel) => {
      const same = panel.state?.split(",")[0] === String(recording.number);
      panel.state = state;
      return same ? panel.chart && fit(panel) : fill(panel);
    }));
  }
  /** These times [s] of the recording, at least a few samples of them; the plots follow with the next picture. */
  let asked = 0;
  function show(from, to) {
    const first = time[0], last = time.at(-1), least = FEWEST * (last - first) / (time.length - 1);
    const span = Math.min(last - first, Math.max(to - from, least));
    const begin = Math.min(last - span, Math.max(first, 0.5 * (from + to - span)));
    view = [begin, begin + span];
    told.value = `${+view[0].toFixed(3)} to ${+view[1].toFixed(3)} s`;
    asked ||= requestAnimationFrame(() => { asked = 0; refresh(); });
  }
  const all = () => { bands = []; redraw(); goto.selectedIndex = 0; show(time[0], time.at(-1)); };
  const zoom = (factor, t = 0.5 * (view[0] + view[1])) => show(t - (t - view[0]) * factor, t + (view[1] - t) * factor);
  const move = (share) => { const by = share * (view[1] - view[0]); show(view[0] + by, view[1] + by); };
  const redraw = () => panels.forEach((panel) => panel.chart?.redraw(false));

  async function choose(number) {
    recording = plan.recordings.find((one) => one.number === number) ?? plan.recordings[0];
    time = await timesOf(recording.number);
    which.value = recording.number;
  }
  /** A place that an answer speaks of. */
  async function go(number) {
    const {recording: of, begin, end, bands: meant} = plan.places[number];
    if (of !== recording.number) await choose(of);
    bands = meant.length ? meant : [[begin, end]];
    goto.value = number;
    redraw();
    const room = MARGIN * (end - begin);
    show(begin - room, end + room);
    section.scrollIntoView({behavior: matchMedia("(prefers-reduced-motion: reduce)").matches ? "auto" : "smooth"});
  }
  /** The window after (1) or before (-1) the middle of what is shown. */
  function step(direction) {
    const middle = 0.5 * (view[0] + view[1]), {windows} = recording;
    const now = windows.findLastIndex(([first], k) => (k ? time[windows[k - 1][1]] : time[0]) <= middle);
    const next = Math.min(windows.length - 1, Math.max(0, now + direction));
    const begin = next ? time[windows[next - 1][1]] : time[0];
    bands = [];
    show(begin, time[windows[next][1]]);
  }

  // ---- hands -----------------------------------------------------------------------------------------------------
  /** The wheel where a plot has the focus or with Ctrl; fingers: one moves what is enlarged, two enlarge. */
  function gestures({chart, canvas}) {
    const {over} = chart, fingers = new Map();
    const timeAt = ({clientX}) => {  // by what is asked for: the picture may be behind
      const {left, width} = over.getBoundingClientRect();
      return view[0] + (clientX - left) / width * (view[1] - view[0]);
    };
    canvas.addEventListener("wheel", (event) => {
      if (!event.ctrlKey && document.activeElement !== canvas) return;
      event.preventDefault();
      if (Math.abs(event.deltaX) > Math.abs(event.deltaY)) move(event.deltaX / over.clientWidth);
      else zoom(2 ** (event.deltaY / 250), timeAt(event));
    }, {passive: false});
    over.addEventListener("pointerdown", (event) => {
      if (event.pointerType === "touch") fingers.set(event.pointerId, timeAt(event));
    });
    over.addEventListener("pointermove", (event) => {
      if (!fingers.has(event.pointerId)) return;
      const held = fingers.get(event.pointerId);
      const other = [...fingers].find(([id]) => id !== event.pointerId)?.[1];
      if (other === undefined) return show(view[0] + held - timeAt(event), view[1] + held - timeAt(event));
      const apart = timeAt(event) - other;
      if (Math.abs(apart) > 1e-9) zoom(Math.min(4, Math.max(0.25, Math.abs((held - other) / apart))), other);
    });
    for (const end of ["pointerup", "pointercancel", "pointerleave"])
      over.addEventListener(end, (event) => fingers.delete(event.pointerId));
  }
  const keys = {"+": () => zoom(0.5), "=": () => zoom(0.5), "-": () => zoom(2), "0": () => all(), Escape: () => all(),
    ArrowLeft: () => move(-0.25), ArrowRight: () => move(0.25), PageUp: () => step(-1), PageDown: () => step(1)};
  root.addEventListener("keydown", (event) => {
    if (!(event.key in keys) || !event.target.matches(".canvas") || event.ctrlKey || event.metaKey) return;
    event.preventDefault();
    keys[event.key]();
  });

  const button = (text, what, act) => {
    const made = make("button", {type: "button", textContent: text, title: what, attributes: {"aria-label": what}});
    made.addEventListener("click", act);
    return made;
  };
  const which = make("select", {attributes: {"aria-label": "recording"}},
    ...plan.recordings.map((one) => new Option(one.name, one.number)));
  which.addEventListener("change", async () => { await choose(Number(which.value)); all(); });
  const goto = make("select", {attributes: {"aria-label": "go to a place"}}, new Option("go to …", ""));
  for (const [answer, title] of [["where", "named by the diagnosis"], ["how far", "worst windows"]]) {
    const own = plan.places.map((place, k) => [place, k]).filter(([place]) => place.answer === answer);
    const options = own.map(([place, k]) => new Option(place.label, k));
    if (options.length) goto.append(make("optgroup", {label: title}, ...options));
  }
  goto.addEventListener("change", () => goto.value === "" ? all() : go(Number(goto.value)));
  const clock = make("output", {className: "clock", attributes: {"aria-label": "time at the cursor"}});
  const told = make("output", {className: "told", attributes: {"aria-label": "times shown"}});
  const toggles = Object.entries(plan.kinds).map(([kind, {name}]) => {
    const toggle = make("button", {type: "button", className: "kind", attributes: {"aria-pressed": !off.has(kind)}},
      swatch(kind), name);
    toggle.addEventListener("click", () => {
      off[off.has(kind) ? "delete" : "add"](kind);
      toggle.setAttribute("aria-pressed", !off.has(kind));
      hide();
    });
    return toggle;
  });
  function hide() {
    for (const {kinds, chart, keys: own} of panels) kinds.forEach((kind, k) => {
      own[k].hidden = off.has(kind);
      chart?.setSeries(k + 1, {show: !off.has(kind)});
    });
  }
  const bar = make("div", {className: "bar"}, ...(plan.recordings.length > 1 ? [which] : []),
    ...(plan.places.length ? [goto] : []),
    make("span", {className: "group"}, button("◀", "window before", () => step(-1)), "window",
      button("▶", "window after", () => step(1))),
    make("span", {className: "group"}, button("−", "show more time", () => zoom(2)),
      button("+", "enlarge", () => zoom(0.5)), button("All", "All: show the whole recording", () => all())), told, clock);
  root.append(bar, make("div", {className: "kinds"}, ...toggles), ...panels.map((panel) => panel.box));
  hide();
  for (const one of document.querySelectorAll("button[data-place]"))
    one.addEventListener("click", () => go(Number(one.dataset.place)));

  /** What has not come near yet, one plot after the other whenever the browser has time: captures are whole. */
  const idle = () => new Promise((done) => "requestIdleCallback" in window ? requestIdleCallback(done) : setTimeout(done, 50));
  async function drawRest() {
    for (const panel of panels) {
      await idle();
      if (panel.chart) continue;
      panel.state = [recording.number, ...view].join();
      await fill(panel);
    }
    window.pamidDrawn = performance.now();
  }

  // ---- begin: the first plot at once, the others when they come near ------------------------------------------------
  const seen = new IntersectionObserver((entries) => {
    for (const {target, isIntersecting} of entries) panels.find((one) => one.box === target).near = isIntersecting;
    if (recording) refresh();
  }, {rootMargin: "400px 0px"});
  new ResizeObserver(() => {
    for (const {chart, canvas} of panels)
      if (chart && canvas.clientWidth) chart.setSize({width: canvas.clientWidth, height: canvas.clientHeight});
  }).observe(root);
  document.addEventListener("pamid-colours", () => { colours = {}; redraw(); });
  choose(plan.recordings[0].number).then(async () => {
    view = [time[0], time.at(-1)];
    show(...view);
    panels.slice(0, 2).forEach((panel) => { panel.near = true; });
    await refresh();
    panels.forEach((panel) => seen.observe(panel.box));
    performance.mark("pamid-ready");
    window.pamidReady = performance.now();
    window.pamid = {panels, show, go, all, get view() { return [...view]; }};
    drawRest();
  });
})();
