// Curves over labelled axes as SVG that fits the width it has. A curve is known by colour, by dashes and by its entry in the legend, which hides it.
//
// P.chart(place, { title, x, y, series: [{ label, points: [[x, y], ...], style, step, band: [[x, low, high], ...] }], bars, ticks }) draws into `place` and gives
// { cursor(x) }, which moves a line. `y` of a point may be null: a gap. `style` is a number, or "truth"; `dots` marks points, `loose` ones
// are not joined; with `whiskers` the band is a bar at each point. `bars` are exposures [from, to, y, label], `ticks` events [x, isOn]; `isLog`: x by its logarithm; `hasZero`: y reaches 0.
{
  const DASHES = ["", "8 3", "3 2", "10 3 3 3", "15 4", "5 3", "2 2", "12 3 3 3 3 3"];
  const line = (style) =>
    style === "truth" ? { stroke: "var(--truth)", "stroke-width": 2.4 } : { stroke: `var(--c${style % 8})`, "stroke-dasharray": DASHES[style % DASHES.length] };

  // Points of different curves differ in shape.
  const SHAPES = ["M-3,-3h6v6h-6z", "M0,-4L4,3H-4z", "M0,-4L4,0L0,4L-4,0z", "M-3,-3L3,3M3,-3L-3,3", "M0,4L4,-3H-4z", "M-4,0H4M0,-4V4", "M-2,-4h4v8h-4z", "M-4,-2h8v4h-8z"];
  const mark = (x, y, style) =>
    P.svg("path", { d: SHAPES[style === "truth" ? 0 : style % 8], transform: `translate(${x.toFixed(1)} ${y.toFixed(1)})`, fill: line(style).stroke, stroke: line(style).stroke, "stroke-width": 1.2 });

  // Round values of a positive range: 1, 2 and 5 times each power of ten, powers alone over many; the ends of a narrow one.
  const ratios = (low, high) => {
    const values = [];
    for (let power = Math.floor(Math.log10(low)); power <= Math.log10(high); power++) for (const k of high > 1000 * low ? [1] : [1, 2, 5]) values.push(k * 10 ** power);
    const inside = values.filter((value) => value >= low && value <= high);
    return (inside.length > 1 ? inside : [low, high]).map((value) => [value, P.number(value)]);
  };

  const range = (values) => {
    let low = Infinity, high = -Infinity;
    for (const value of values) if (value !== null && Number.isFinite(value)) (low = Math.min(low, value)), (high = Math.max(high, value));
    if (low > high) return [0, 1];
    const room = high > low ? 0.05 * (high - low) : Math.abs(high) * 0.05 || 1;
    return [low - room, high + room];
  };

  const draw = (place, spec, hidden) => {
    const width = Math.max(280, Math.floor(place.clientWidth || 640)), height = spec.height ?? (width < 500 ? 230 : 280);
    const left = 58, right = 10, top = spec.title ? 26 : 10, bottom = 42;
    const shown = spec.series.filter((one) => !hidden.has(one.label));
    const xs = shown.flatMap((one) => one.points.map((point) => point[0])).concat((spec.bars ?? []).flatMap((bar) => [bar[0], bar[1]]));
    const ys = shown.flatMap((one) => one.points.map((point) => point[1]).concat((one.band ?? []).flatMap((band) => [band[1], band[2]])));
    const [x0, x1] = spec.xRange ?? [Math.min(...xs), Math.max(...xs)].map((value, at) => (Number.isFinite(value) ? value : at));
    const [y0, y1] = range(ys.concat((spec.bars ?? []).map((bar) => bar[2]), spec.hasZero ? [0] : []));
    const scaled = spec.isLog ? Math.log10 : (value) => value;
    const span = x1 > x0 ? scaled(x1) - scaled(x0) : 1;
    const x = (value) => left + ((scaled(value) - scaled(x0)) / span) * (width - left - right);
    const y = (value) => height - bottom - ((value - y0) / (y1 - y0)) * (height - bottom - top);
    const svg = P.svg("svg", { class: "chart", viewBox: `0 0 ${width} ${height}`, role: "img", "aria-label": `${spec.title ?? ""}: ${spec.y} over ${spec.x}` });
    if (spec.title) svg.append(P.svg("text", { class: "title", x: left, y: 16 }, spec.title));
    for (const [value, text] of P.steps(y0, y1, height / 50)) {
      svg.append(P.svg("line", { class: value === 0 ? "axis" : "grid", x1: left, x2: width - right, y1: y(value), y2: y(value) }));
      svg.append(P.svg("text", { x: left - 6, y: y(value) + 4, "text-anchor": "end" }, text));
    }
    for (const [value, text] of spec.isLog ? ratios(x0, x1) : P.steps(x0, x0 + span, width / 90)) {
      svg.append(P.svg("line", { class: "grid", x1: x(value), x2: x(value), y1: top, y2: height - bottom }));
      svg.append(P.svg("text", { x: x(value), y: height - bottom + 16, "text-anchor": "middle" }, text));
    }
    svg.append(P.svg("path", { class: "axis", fill: "none", d: `M${left},${top}V${height - bottom}H${width - right}` }));
    svg.append(P.svg("text", { x: (left + width - right) / 2, y: height - 6, "text-anchor": "middle" }, spec.x));
    const middle = (top + height - bottom) / 2;
    svg.append(P.svg("text", { x: 12, y: middle, "text-anchor": "middle", transform: `rotate(-90 12 ${middle})` }, spec.y));
    for (const one of shown) {
      if (one.whiskers) for (const [at, low, high] of one.band) svg.append(P.svg("line", { x1: x(at), x2: x(at), y1: y(low), y2: y(high), stroke: line(one.style).stroke }));
      else if (one.band?.length) {
        const edge = (side) => one.band.map((band) => `${x(band[0]).toFixed(1)},${y(band[side]).toFixed(1)}`);
        svg.append(P.svg("polygon", { class: "band", fill: line(one.style).stroke, points: edge(2).concat(edge(1).reverse()).join(" ") }));
      }
      let path = "", open = false;
      for (const [px, py] of one.points) {
        if (py === null || !Number.isFinite(py)) open = false;
        else {
          const [cx, cy] = [x(px).toFixed(1), y(py).toFixed(1)];
          path += !open ? `M${cx},${cy}` : one.step ? `H${cx}V${cy}` : `L${cx},${cy}`;
          open = true;
        }
      }
      if (!one.loose) svg.append(P.svg("path", { class: "curve", d: path, ...line(one.style) }));
      if (one.dots || one.loose || one.points.length === 1) for (const [px, py] of one.points) if (py !== null) svg.append(mark(x(px), y(py), one.style));
    }
    for (const [from, to, value, label] of spec.bars ?? []) {
      const bar = P.svg("line", { class: "exposure", x1: x(from), x2: Math.max(x(to), x(from) + 1), y1: y(value), y2: y(value) });
      bar.append(P.svg("title", {}, label));
      svg.append(bar);
    }
    for (const [at, isOn] of spec.ticks ?? []) {
      if (at < x0 || at > x1) continue;
      const [cx, base] = [x(at), isOn ? top + 9 : height - bottom - 9];
      svg.append(P.svg("path", { class: isOn ? "on" : "off", d: isOn ? `M${cx - 4},${base}h8l-4,-8z` : `M${cx - 4},${base}h8l-4,8z` }));
    }
    const cursor = P.svg("line", { class: "cursor", x1: -9, x2: -9, y1: top, y2: height - bottom });
    svg.append(cursor);
    return { svg, move: (value) => ["x1", "x2"].forEach((key) => cursor.setAttribute(key, value >= x0 && value <= x1 ? x(value) : -9)) };
  };

  P.chart = (place, spec) => {
    const hidden = new Set();
    let drawn = null, at = null;
    const box = P.make("div");
    const redraw = () => {
      drawn = draw(box, spec, hidden);
      box.replaceChildren(drawn.svg);
      if (at !== null) drawn.move(at);
    };
    const legend = P.make("ul", { class: "legend", "aria-label": "Curves: press to hide or show" });
    if (spec.series.length > 1 || spec.legend) {
      for (const one of spec.series) {
        const sample = P.svg("svg", { viewBox: "0 0 30 12", "aria-hidden": "true" });
        if (!one.loose) sample.append(P.svg("path", { d: "M1,6H29", fill: "none", "stroke-width": 2.4, ...line(one.style) }));
        if (one.loose || one.dots) sample.append(mark(15, 6, one.style));
        const button = P.make("button", { type: "button", "aria-pressed": "true" });
        button.append(sample, one.label);
        button.addEventListener("click", () => {
          hidden.has(one.label) ? hidden.delete(one.label) : hidden.add(one.label);
          button.setAttribute("aria-pressed", String(!hidden.has(one.label)));
          redraw();
        });
        legend.append(P.make("li", {}, button));
      }
    }
    place.replaceChildren(box, legend);
    redraw();
    let width = box.clientWidth;
    P.onWidth(box, () => {
      if (box.clientWidth === width) return;
      width = box.clientWidth;
      redraw();
    });
    return { cursor: (value) => ((at = value), drawn.move(value)) };
  };

  // The charts that a page states: `data-chart` names an entry of data.charts. Those over time follow the frame that is looked at.
  document.querySelectorAll("[data-chart]").forEach((place) => {
    const spec = P.data.charts[Number(place.dataset.chart)];
    const chart = P.chart(place, spec);
    if (spec.isTime) P.on("instant", (ns) => chart.cursor(ns / 1e6));
  });
}
