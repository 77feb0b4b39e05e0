"use strict";
(function () {
  const byId = (id) => document.getElementById(id);
  const data = JSON.parse(byId("data").textContent);
  const c = data.columns, rows = c.t.length;
  // Long series are drawn as the least and the greatest of so many parts of what is in view.
  const PARTS = 700;
  const STATES = ["not processed", "searching", "coasting", "tracking"];
  // Printed, plots are as wide as a sheet of A4 or Letter, whatever the window was.
  const PRINTED = 680;
  const narrow = () => !printing && window.innerWidth <= 860;
  let chosen = 0, printing = false;

  // The chosen frame: picture, numbers, film strip. None of it needs the plots.

  const buttons = new Map();
  document.querySelectorAll("#strip button").forEach((b) => buttons.set(+b.dataset.row, b));

  function number(name, digits, unit, sigma) {
    const value = c[name][chosen];
    if (value === null) { return "not known"; }
    const spread = sigma && c[sigma][chosen] !== null
      ? " ± " + (1.96 * c[sigma][chosen]).toFixed(digits) : "";
    return value.toFixed(digits) + spread + unit;
  }

  function values() {
    const side = c.side[chosen] || "not known";
    const bed = ["bedLeft", "bedRight"].map((k) =>
      c[k][chosen] === null ? "?" : c[k][chosen].toFixed(2)).join(" / ");
    return [
      ["state", STATES[c.state[chosen]] + (c.valid[chosen] ? "" : ", not valid")],
      ["quality", number("quality", 2, "")],
      ["distance", number("distance", 3, " m", "sigmaDistance")],
      ["heading", number("heading", 1, "°", "sigmaHeading")],
      ["pitch", number("pitch", 1, "°", "sigmaPitch")],
      ["approach", number("speed", 3, " m/s", "sigmaSpeed")],
      ["lateral offset", number("lateral", 2, " m")],
      ["chainage", number("chainage", 2, " m")],
      ["side", side],
      ["axis above bed, port / starboard", bed === "? / ?" ? "not known" : bed + " m"],
    ];
  }

  function nearestPicture(row) {
    let best = null;
    for (const k of data.pictures) {
      if (best === null || Math.abs(k - row) < Math.abs(best - row)) { best = k; }
    }
    return best;
  }

  function caption(pictured) {
    const box = byId("caption"), place = document.createElement("b");
    place.textContent = `Frame ${chosen + 1} of ${rows}, ${c.t[chosen].toFixed(1)} s`;
    box.replaceChildren(place);
    const why = data.reasons[c.reason[chosen]];
    let said = why ? ` · ${why}` : "";
    if (pictured === null) {
      said += " · no picture";
    } else if (pictured !== chosen) {
      const off = (c.t[pictured] - c.t[chosen]).toFixed(1);
      said += ` · picture of frame ${pictured + 1}, ${Math.abs(off)} s ${off < 0 ? "before" : "after"}`;
    }
    box.append(`${said} · stamp ${c.stamp[chosen]}`);
  }

  function showFrame() {
    const pictured = nearestPicture(chosen), image = byId("picture");
    caption(pictured);
    byId("values").replaceChildren(...values().map(([name, value]) => {
      const pair = document.createElement("div");
      const dt = document.createElement("dt"), dd = document.createElement("dd");
      dt.textContent = name;
      dd.textContent = value;
      pair.append(dt, dd);
      return pair;
    }));
    byId("slider").value = chosen;
    document.querySelectorAll("#strip .chosen").forEach((b) => b.classList.remove("chosen"));
    image.hidden = pictured === null;
    if (pictured === null) { return; }
    const button = buttons.get(pictured), strip = byId("strip");
    image.src = button.querySelector("img").src;
    image.alt = `Left image of frame ${pictured + 1} with contours and axis`;
    button.classList.add("chosen");
    strip.scrollLeft = button.offsetLeft - (strip.clientWidth - button.clientWidth) / 2;
  }

  let waiting = false;

  function choose(row) {
    if (!rows || !Number.isFinite(row)) { return; }
    chosen = Math.max(0, Math.min(rows - 1, Math.round(row)));
    showFrame();
    // Keys that repeat come faster than plots are drawn.
    if (!waiting) {
      waiting = true;
      requestAnimationFrame(() => { waiting = false; figures.forEach((figure) => figure.mark()); });
    }
  }

  function step(way, single) {
    if (single || !data.pictures.length) { return choose(chosen + way); }
    const further = data.pictures.filter((k) => way * (k - chosen) > 0);
    if (further.length) { choose(way > 0 ? further[0] : further[further.length - 1]); }
  }

  function listen() {
    byId("slider").addEventListener("input", (event) => choose(+event.target.value));
    byId("back").addEventListener("click", () => step(-1, false));
    byId("on").addEventListener("click", () => step(1, false));
    document.querySelectorAll("button[data-row]").forEach((b) => b.addEventListener("click", () => {
      choose(+b.dataset.row);
      if (b.classList.contains("link")) { byId("frames").scrollIntoView({ block: "start" }); }
    }));
    document.addEventListener("keydown", (event) => {
      const ways = { ArrowLeft: -1, ArrowRight: 1, Home: -rows, End: rows };
      const way = ways[event.key];
      if (way === undefined || event.altKey || event.ctrlKey || event.metaKey) { return; }
      if (event.target.closest("input, .scroll, pre, summary")) { return; }
      event.preventDefault();
      if (Math.abs(way) > 1) { choose(chosen + way); } else { step(way, event.shiftKey); }
    });
  }

  // Plots.

  const figures = [];
  const LIGHT = { paper: "#ffffff", line: "#dde1e6", ink: "#1c2127", soft: "#5a6470",
    blue: "#0072b2", orange: "#c77f00", green: "#00795a", red: "#c14f00" };

  function palette() {
    if (printing) { return LIGHT; }
    const style = getComputedStyle(document.documentElement), colours = {};
    for (const name of Object.keys(LIGHT)) {
      colours[name] = style.getPropertyValue(`--${name}`).trim() || LIGHT[name];
    }
    return colours;
  }

  function faint(colour, opacity) {
    const [r, g, b] = [1, 3, 5].map((k) => parseInt(colour.slice(k, k + 2), 16));
    return `rgba(${r},${g},${b},${opacity})`;
  }

  function config() {
    const touch = window.matchMedia("(pointer: coarse)").matches;
    return { displaylogo: false, responsive: true, showTips: false, doubleClick: "reset+autosize",
      displayModeBar: touch ? true : "hover",
      modeBarButtonsToRemove: ["select2d", "lasso2d", "autoScale2d"] };
  }

  function layout(p, more) {
    const touch = window.matchMedia("(pointer: coarse)").matches;
    return Object.assign(printing ? { autosize: false, width: PRINTED } : { autosize: true }, {
      paper_bgcolor: "rgba(0,0,0,0)", plot_bgcolor: "rgba(0,0,0,0)",
      font: { family: "system-ui, sans-serif", size: narrow() ? 11 : 12.5, color: p.soft },
      margin: { l: narrow() ? 48 : 62, r: 10, t: 30, b: narrow() ? 132 : 84 },
      modebar: { bgcolor: "rgba(0,0,0,0)", color: faint(p.soft, 0.7), activecolor: p.blue },
      // A finger on a plot scrolls the page; the buttons zoom.
      dragmode: touch ? false : "zoom",
      hoverlabel: { bgcolor: p.paper, bordercolor: p.line, font: { color: p.ink } },
      legend: Object.assign({ orientation: "h", traceorder: "normal", x: 0, y: 0, yref: "container", yanchor: "bottom" },
        narrow() ? { entrywidth: 0.5, entrywidthmode: "fraction" } : {}),
    }, more);
  }

  function axis(p, title, more) {
    return Object.assign({ title: { text: title, standoff: 8, font: { size: narrow() ? 11 : 12.5 } },
      gridcolor: p.line, zerolinecolor: p.line, linecolor: p.line, tickcolor: p.line }, more);
  }

  const span = (first, last) => Array.from({ length: Math.max(0, last - first + 1) },
    (_, k) => first + k);

  // Rows to draw of a series: all, or the least and the greatest of each part, so that no dip is
  // hidden; a part without any value is a gap.
  function thin(series, first, last) {
    const count = last - first + 1;
    if (count <= 2 * PARTS) { return span(first, last); }
    const kept = [];
    for (let part = 0; part < PARTS; part++) {
      const from = first + Math.floor(part * count / PARTS);
      const to = first + Math.floor((part + 1) * count / PARTS);
      let low = -1, high = -1;
      for (let k = from; k < to; k++) {
        if (series[k] === null) { continue; }
        if (low < 0 || series[k] < series[low]) { low = k; }
        if (high < 0 || series[k] > series[high]) { high = k; }
      }
      if (low < 0) { kept.push(from); } else if (low === high) { kept.push(low); } else {
        kept.push(Math.min(low, high), Math.max(low, high));
      }
    }
    return kept;
  }

  // The rows, from the first to the last, for which a test holds, and one more at each end.
  function inView(test) {
    let first = -1, last = -2;
    for (let k = 0; k < rows; k++) {
      if (test(k)) { last = k; if (first < 0) { first = k; } }
    }
    return first < 0 ? [0, rows - 1] : [Math.max(0, first - 1), Math.min(rows - 1, last + 1)];
  }

  const pick = (series, kept) => kept.map((k) => series[k]);

  function line(x, y, kept, more) {
    // What stands alone between two gaps would not be seen as a line.
    const few = kept.length <= 400;
    return Object.assign({ type: "scatter", mode: few ? "lines+markers" : "lines", x, y,
      customdata: kept, marker: { size: 4 }, showlegend: false }, more);
  }

  // Plots whose x axis is the time.
  class TimePlot {
    // Drawn for print, a box still has its height on the screen; page.css has that on paper too.
    constructor(id, bands, printed) {
      this.box = byId(id);
      // What is never known needs no room; state and quality always are.
      this.bands = bands.filter(({ lines }) => lines.some(({ y }) => y.some((v) => v !== null)));
      const shares = (all) => all.reduce((sum, band) => sum + band.share, 0);
      const left = (0.2 * shares(bands) + shares(this.bands)) / (1.2 * shares(bands));
      this.printed = Math.round(left * printed);
      if (left < 1) { this.box.style.height = `${Math.round(left * this.box.clientHeight)}px`; }
      this.legend = bands.some((band) => band.lines.some((what) => what.legend));
      this.range = null;
    }

    draw() {
      this.p = palette();
      const [from, to] = this.range || [c.t[0], c.t[rows - 1]];
      this.seen = [from, to];
      const [first, last] = this.range ? inView((k) => c.t[k] >= from && c.t[k] <= to)
        : [0, rows - 1];
      const traces = [], axes = {};
      let top = 1;
      this.bands.forEach((band, place) => {
        const key = place ? String(place + 1) : "";
        const height = band.share / this.bands.reduce((sum, b) => sum + b.share, 0);
        axes[`yaxis${key}`] = axis(this.p, band.title, Object.assign(
          { domain: [Math.max(0, top - height + 0.028), top], nticks: 5, fixedrange: true },
          band.axis));
        top -= height;
        for (const what of band.lines) { this.add(traces, what, `y${key}`, first, last); }
      });
      const grid = { shapes: this.shapes(), hovermode: "x", hoverdistance: -1,
        xaxis: axis(this.p, "time since the first frame, s", {
          anchor: this.bands.length > 1 ? `y${this.bands.length}` : "y", zeroline: false }) };
      grid.xaxis.range = this.range ? [...this.range] : padded(c.t);
      const height = printing ? { height: this.printed } : {};
      return Plotly.react(this.box, traces, layout(this.p, Object.assign(grid, axes, height,
        { margin: { l: narrow() ? 68 : 80, r: 10, t: 30, b: this.legend ? 76 : 44 } })), config());
    }

    add(traces, what, yaxis, first, last) {
      const kept = thin(what.y, first, last), x = pick(c.t, kept), y = pick(what.y, kept);
      const colour = this.p[what.colour];
      if (what.sigma) {
        const about = what.centre || what.y;
        const edge = (sign) => kept.map((k) => about[k] === null || what.sigma[k] === null ? null
          : about[k] + sign * 1.96 * what.sigma[k]);
        traces.push(Object.assign(
          filled(undefined, ribbon(x, edge(-1), edge(1)), faint(colour, 0.2), false), { yaxis }));
      }
      traces.push(line(x, y, kept, Object.assign({ yaxis, name: what.name, line: {
        color: colour, width: 1.6, dash: what.dash, shape: what.step ? "hvh" : "linear" },
      marker: { size: 4, color: colour, symbol: what.symbol },
      hovertemplate: what.text ? "%{text}<extra></extra>"
        : `%{y:.${what.digits}f}${what.unit}<extra>${what.name}</extra>`,
      text: what.text ? pick(what.text, kept) : undefined,
      showlegend: Boolean(what.legend) }, what.more)));
    }

    shapes() {
      const [from, to] = this.seen, least = (to - from) / 400, shown = [];
      const between = (a, b) => (c.t[Math.max(0, a)] + c.t[Math.min(rows - 1, b)]) / 2;
      for (const [first, last, coasting] of data.lost) {
        let x0 = between(first - 1, first), x1 = between(last, last + 1);
        if (x1 - x0 < least) { x0 = c.t[first] - least / 2; x1 = c.t[last] + least / 2; }
        if (x1 < from || x0 > to) { continue; }
        const before = shown[shown.length - 1];
        if (before && before.coasting === coasting && x0 - before.x1 < least) { before.x1 = x1; }
        else { shown.push({ x0, x1, coasting }); }
      }
      const shapes = shown.map(({ x0, x1, coasting }) => ({ type: "rect", xref: "x", yref: "paper",
        x0, x1, y0: 0, y1: 1, layer: "below", fillcolor: faint(this.p.soft, coasting ? 0.13 : 0.28),
        line: { width: coasting ? 1 : 0, dash: "dot", color: this.p.soft } }));
      shapes.push({ type: "line", xref: "x", yref: "paper", x0: c.t[chosen], x1: c.t[chosen],
        y0: 0, y1: 1, line: { color: this.p.red, width: 1.5 } });
      return shapes;
    }

    mark() { Plotly.relayout(this.box, { shapes: this.shapes() }); }

    // The row of the drawn point that was clicked: of many in one column of pixels the nearest one,
    // so that a click on the tip of a dip is one on the dip.
    clicked(event) {
      const mouse = event.event.changedTouches ? event.event.changedTouches[0] : event.event;
      const corner = this.box.getBoundingClientRect();
      let best = event.points[0].customdata, least = Infinity;
      for (const { data: trace, xaxis, yaxis } of event.points) {
        const x = mouse.clientX - corner.left - xaxis._offset;
        const y = mouse.clientY - corner.top - yaxis._offset;
        trace.x.forEach((value, k) => {
          const aside = xaxis.d2p(value) - x;
          if (trace.y[k] === null || !(Math.abs(aside) < 6)) { return; }
          const off = Math.hypot(aside, yaxis.d2p(trace.y[k]) - y);
          if (off < least) { least = off; best = trace.customdata[k]; }
        });
      }
      return best;
    }

    listen() {
      this.box.on("plotly_click", (event) => choose(this.clicked(event)));
      this.box.on("plotly_relayout", (event) => {
        const zoomed = event["xaxis.range[0]"] !== undefined || event["xaxis.range"];
        if (event["xaxis.autorange"]) { this.range = null; }
        else if (zoomed) { this.range = this.box.layout.xaxis.range.map(Number); }
        else { return; }
        this.draw();
      });
    }
  }

  function padded(series) {
    const low = Math.min(series[0], series[rows - 1]), high = Math.max(series[0], series[rows - 1]);
    const edge = Math.max(0.015 * (high - low), 0.5);
    return [low - edge, high + edge];
  }

  // Plan and profile. Polygons about the axis are broken where the pipe was not followed.
  class WayPlot {
    constructor(id, make, printed) {
      this.box = byId(id);
      this.make = make;
      this.printed = printed;
      this.rows = [0, rows - 1];
      this.ranges = null;
    }

    draw() {
      const p = palette(), made = this.make(p, ...this.rows);
      this.spot = made.spot;
      this.inside = made.inside;
      this.place = made.traces.length;
      const traces = made.traces.concat([Object.assign({ type: "scatter", mode: "lines+markers",
        name: "chosen frame", hoverinfo: "skip", marker: { size: [11, 11], color: p.red,
          symbol: ["circle-open", "diamond-open"], line: { width: 2.5 } },
        line: { color: p.red, width: 1, dash: "dot" } }, made.spot())]);
      if (made.size) { this.fit(...made.size); }
      if (this.ranges) {
        made.layout.xaxis.range = this.ranges[0];
        made.layout.yaxis.range = this.ranges[1];
      }
      return Plotly.react(this.box, traces, layout(p, Object.assign({ hovermode: "closest" },
        printing ? { height: this.printed } : {}, made.layout)), config());
    }

    // A long way that hardly bends leaves most of a plot of equal scales empty: less height.
    fit(across, up) {
      const width = (printing ? PRINTED : this.box.clientWidth) - 72;
      const wanted = 1.2 * width * up / across + (narrow() ? 162 : 114);
      this.printed = Math.round(Math.min(420, Math.max(290, wanted)));
      this.box.style.height = `${this.printed}px`;
    }

    mark() {
      const { x, y } = this.spot();
      Plotly.restyle(this.box, { x: [x], y: [y] }, [this.place]);
    }

    listen() {
      this.box.on("plotly_click", (event) => choose(event.points[0].customdata));
      this.box.on("plotly_relayout", (event) => {
        const keys = Object.keys(event);
        if (keys.some((key) => key.endsWith("autorange"))) {
          this.rows = [0, rows - 1];
          this.ranges = null;
        } else if (keys.some((key) => /^[xy]axis.range/.test(key))) {
          const { xaxis, yaxis } = this.box.layout;
          this.ranges = [[...xaxis.range], [...yaxis.range]];
          this.rows = inView((k) => this.inside(k, ...this.ranges));
        } else { return; }
        this.draw();
      });
    }
  }

  const followed = c.valid.map((valid, k) => Boolean(valid) && c.pipeX[k] !== null);
  const lostPath = c.valid.map((valid) => !valid);

  // A closed band about a line, one polygon for each run that was followed.
  function band(kept, edge) {
    const x = [], y = [];
    let run = [];
    const close = () => {
      if (run.length > 1) {
        const there = run.map((k) => edge(k, 1)), back = run.map((k) => edge(k, -1)).reverse();
        for (const [a, b] of there.concat(back, [there[0], [null, null]])) { x.push(a); y.push(b); }
      }
      run = [];
    };
    kept.forEach((k, place) => {
      const before = kept[place - 1];
      if (place && followed.slice(before, k).includes(false)) { close(); }
      if (followed[k]) { run.push(k); } else { close(); }
    });
    close();
    return { x, y };
  }

  // A closed band between two lines, one polygon for each run without a gap.
  function ribbon(x, low, high) {
    const xs = [], ys = [];
    for (let k = 0; k < x.length; k++) {
      const first = k;
      while (k < x.length && low[k] !== null) { k++; }
      if (k - first < 2) { continue; }
      const run = span(first, k - 1), back = [...run].reverse();
      xs.push(...pick(x, run), ...pick(x, back), x[first], null);
      ys.push(...pick(low, run), ...pick(high, back), low[first], null);
    }
    return { x: xs, y: ys };
  }

  function filled(name, shape, colour, legend) {
    return Object.assign({ type: "scatter", mode: "lines", fill: "toself", name, hoverinfo: "skip",
      line: { width: 0 }, fillcolor: colour, showlegend: legend }, shape);
  }

  function only(series, test) { return series.map((value, k) => test[k] ? value : null); }

  // A line through the rows where a test holds, and through one more at each end.
  function widened(test) {
    return test.map((inside, k) => inside || test[k - 1] || test[k + 1] || false);
  }

  function plan(p, first, last) {
    const by = Math.max(1, Math.ceil((last - first + 1) / (2 * PARTS)));
    const kept = span(first, last).filter((k) => (k - first) % by === 0 || k === last
      || followed[k] !== followed[k - 1] || followed[k] !== followed[k + 1]);
    const beside = (width) => (k, sign) => [c.pipeX[k] - sign * width(k) * c.aheadY[k],
      c.pipeY[k] + sign * width(k) * c.aheadX[k]];
    const x = only(c.pipeX, followed), y = only(c.pipeY, followed);
    const carried = c.state.map((state, k) => state === 2 && c.pipeX[k] !== null);
    const lost = widened(lostPath);
    const hover = (what) => `${what}<br>%{x:.2f}, %{y:.2f} m<extra></extra>`;
    const traces = [
      filled("pipe", band(kept, beside(() => data.radius)), faint(p.blue, 0.22), true),
      filled("95 % of the axis", band(kept, beside((k) => 1.96 * (c.sigmaLeft[k] || 0))),
        faint(p.blue, 0.55), true),
      line(pick(x, kept), pick(y, kept), kept, { name: "axis", line: { color: p.blue, width: 1.6 },
        marker: { size: 4, color: p.blue }, hovertemplate: hover("axis"), showlegend: true }),
      line(pick(c.ownX, kept), pick(c.ownY, kept), kept, { name: "vehicle", mode: "lines",
        line: { color: p.green, width: 1.6 }, hovertemplate: hover("vehicle"), showlegend: true }),
    ];
    if (carried.includes(true)) {
      traces.push(line(pick(only(c.pipeX, carried), kept), pick(only(c.pipeY, carried), kept), kept,
        { name: "axis, coasting", mode: "markers", hovertemplate: hover("coasting"),
          marker: { size: 6, symbol: "x-thin", line: { color: p.soft, width: 1.5 } },
          showlegend: true }));
    }
    if (lostPath.includes(true)) {
      traces.push(line(pick(only(c.ownX, lost), kept), pick(only(c.ownY, lost), kept), kept,
        { name: "vehicle, pipe lost", mode: "lines", showlegend: true,
          line: { color: p.red, width: 3, dash: "dot" }, hovertemplate: hover("not valid") }));
    }
    const extent = (...all) => {
      const known = all.flat().filter((v) => v !== null);
      return known.reduce((a, v) => Math.max(a, v)) - known.reduce((a, v) => Math.min(a, v));
    };
    const within = (v, range) => v !== null && v >= Math.min(...range) && v <= Math.max(...range);
    const size = [extent(c.ownX, x), extent(c.ownY, y) + 2 * data.radius];
    return { traces, size: size[0] > 0 ? size : null,
      spot: () => ({ x: [c.ownX[chosen], c.pipeX[chosen]], y: [c.ownY[chosen], c.pipeY[chosen]] }),
      inside: (k, xs, ys) => (within(c.pipeX[k], xs) && within(c.pipeY[k], ys))
        || (within(c.ownX[k], xs) && within(c.ownY[k], ys)),
      layout: { xaxis: axis(p, "x in odom, m", { scaleanchor: "y", zeroline: false }),
        yaxis: axis(p, "y in odom, m", { zeroline: false }) } };
  }

  function profile(p, first, last) {
    const z = only(c.pipeZ, followed), x = only(c.pipeChainage, followed);
    const kept = thin(z, first, last).sort((a, b) => a - b);
    const above = (width) => (k, sign) => [c.pipeChainage[k], c.pipeZ[k] + sign * width(k)];
    const bed = (side) => c[side].map((height, k) =>
      height === null || !followed[k] ? null : +(c.pipeZ[k] - height).toFixed(3));
    const hover = (what) => `${what}<br>chainage %{x:.2f} m, z %{y:.2f} m<extra></extra>`;
    const bedLine = (side, name, dash, symbol) => {
      const series = bed(side), few = thin(series, first, last);
      return line(pick(c.pipeChainage, few), pick(series, few), few, { name, hovertemplate: hover(name),
        line: { color: p.orange, width: 1.4, dash }, marker: { size: 5, color: p.orange, symbol },
        showlegend: true });
    };
    const own = thin(c.ownZ, first, last);
    return {
      traces: [
        filled("pipe", band(kept, above(() => data.radius)), faint(p.blue, 0.22), true),
        filled("95 % of the axis", band(kept, above((k) => 1.96 * (c.sigmaUp[k] || 0))),
          faint(p.blue, 0.55), true),
        line(pick(x, kept), pick(z, kept), kept, { name: "axis", line: { color: p.blue, width: 1.6 },
          marker: { size: 4, color: p.blue }, hovertemplate: hover("axis"), showlegend: true }),
        ...["bedLeft", "bedRight"].filter((side) => c[side].some((v) => v !== null)).map((side) =>
          side === "bedLeft" ? bedLine(side, "bed to port", "solid", "triangle-up")
            : bedLine(side, "bed to starboard", "dash", "triangle-down")),
        line(pick(c.chainage, own), pick(c.ownZ, own), own, { name: "vehicle", mode: "lines",
          line: { color: p.green, width: 1.6 }, hovertemplate: hover("vehicle"), showlegend: true }),
      ],
      spot: () => ({ x: [c.chainage[chosen], c.pipeChainage[chosen]],
        y: [c.chainage[chosen] === null ? null : c.ownZ[chosen], c.pipeZ[chosen]] }),
      inside: (k, xs) => c.chainage[k] !== null && c.chainage[k] >= Math.min(...xs) - 5
        && c.chainage[k] <= Math.max(...xs) + 5,
      layout: { xaxis: axis(p, "chainage, m", { zeroline: false }),
        yaxis: axis(p, "z in odom, m", { zeroline: false }) },
    };
  }

  function timeLines() {
    const states = c.state.map((state, k) => STATES[state] + (c.valid[k] ? "" : ", not valid")
      + (data.reasons[c.reason[k]] ? ": " + data.reasons[c.reason[k]].slice(0, 80) : ""));
    const one = (title, name, unit, digits, colour, sigma) => ({ title, share: 1, lines: [{
      y: c[name], name, unit, digits, colour, sigma: sigma && c[sigma] }] });
    return [
      { title: "", share: 0.75, axis: { tickvals: [0, 1, 2, 3],
        ticktext: ["not proc.", "searching", "coasting", "tracking"], range: [-0.4, 3.4] },
      lines: [{ y: c.state, name: "state", text: states, colour: "ink", step: true }] },
      { title: "quality", share: 1, axis: { rangemode: "tozero" }, lines: [{ y: c.quality,
        name: "quality", unit: "", digits: 2, colour: "blue" }] },
      one("heading, °", "heading", "°", 2, "blue", "sigmaHeading"),
      one("pitch, °", "pitch", "°", 2, "blue", "sigmaPitch"),
      one("distance, m", "distance", " m", 3, "blue", "sigmaDistance"),
      one("approach, m/s", "speed", " m/s", 3, "blue", "sigmaSpeed"),
    ];
  }

  function errorLines() {
    const e = data.errors, none = e.distance.map((v) => v === null ? null : 0);
    const wrong = e.horizontal.map(() => null);
    e.wrong.forEach((k) => { wrong[k] = e.horizontal[k] === null ? 0 : e.horizontal[k]; });
    const bands = [
      { title: "both ends, cm", share: 1, axis: { rangemode: "tozero" }, lines: [
        { y: e.horizontal, name: "horizontal", unit: " cm", digits: 2, colour: "blue",
          legend: true },
        { y: e.vertical, name: "vertical", unit: " cm", digits: 2, colour: "orange", dash: "dash",
          symbol: "square", legend: true }] },
      { title: "distance, cm", share: 1, lines: [{ y: e.distance, centre: none, name: "distance",
        sigma: e.sigmaDistance, unit: " cm", digits: 2, colour: "blue" }] },
      { title: "heading, °", share: 1, lines: [{ y: e.heading, centre: none, name: "heading",
        sigma: e.sigmaHeading, unit: "°", digits: 3, colour: "blue" }] },
    ];
    if (e.wrong.length) {
      bands[0].lines.push({ y: wrong, name: "false valid", unit: " cm", digits: 2, colour: "red",
        legend: true, more: { mode: "markers", marker: { size: 10, symbol: "x", color: palette().red } } });
    }
    return bands;
  }

  async function unpacked() {
    const packed = Uint8Array.from(atob(byId("plotly").textContent), (x) => x.charCodeAt(0));
    const stream = new Blob([packed]).stream().pipeThrough(new DecompressionStream("gzip"));
    return new Response(stream).text();
  }

  async function plots() {
    const library = document.createElement("script");
    library.textContent = await unpacked();
    document.head.append(library);
    if (byId("timelines")) { figures.push(new TimePlot("timelines", timeLines(), 560)); }
    if (byId("plan")) { figures.push(new WayPlot("plan", plan, 420)); }
    if (byId("profile")) { figures.push(new WayPlot("profile", profile, 360)); }
    if (byId("errorlines")) { figures.push(new TimePlot("errorlines", errorLines(), 400)); }
    for (const figure of figures) {
      await figure.draw();
      figure.listen();
    }
    const again = () => figures.forEach((figure) => figure.draw());
    window.matchMedia("(prefers-color-scheme: dark)").addEventListener("change", again);
    window.addEventListener("beforeprint", () => { printing = true; again(); });
    window.addEventListener("afterprint", () => { printing = false; again(); });
  }

  if (rows) {
    listen();
    choose(data.pictures.length ? data.pictures[0] : 0);
  }
  plots().then(() => { document.documentElement.dataset.plots = "drawn"; }).catch((error) => {
    document.documentElement.dataset.plots = "failed";
    figures.length = 0;
    document.querySelectorAll(".plot").forEach((box) => {
      box.style.height = "auto";
      box.textContent = `This plot needs a newer browser (${error.message}).`;
    });
  });
})();
