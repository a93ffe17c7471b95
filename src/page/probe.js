// One pixel over time: the DN of every sequence, and for the pixels that the report holds more of: events, exposures, voltages, posterior band, residuals.
{
  const root = document.getElementById("probe-tool");
  const part = (name) => root.querySelector(`[data-part="${name}"]`);
  const [chooser, column, row, solved] = ["pixel", "x", "y", "solved"].map(part);
  const full = P.data.pixels ?? [];
  let now = null, charts = [], turn = 0;

  full.forEach((pixel, at) => chooser.append(P.make("option", { value: at }, `x ${pixel.x}, y ${pixel.y}`)));
  const known = (x, y) => full.findIndex((pixel) => pixel.x === x && pixel.y === y);
  const place = (name) => {
    const box = P.make("div");
    part(name).replaceChildren(box);
    return box;
  };
  const range = (group) => [group.instants_ns[0] / 1e6, group.instants_ns[group.instants_ns.length - 1] / 1e6];

  // DN of all sequences at all instants, from the pictures; exposures of the held pixel as bars.
  const brightness = async (group, x, y, pixel, mine) => {
    const px = Math.floor(x / group.shrink), py = Math.floor(y / group.shrink);
    const series = [];
    for (const [at, one] of group.sequences.entries()) {
      const points = [];
      for (let instant = 0; instant < group.instants_ns.length; instant++) {
        const picture = await P.picture(group, at, instant);
        if (mine !== turn) return;
        points.push([group.instants_ns[instant] / 1e6, group.black + P.linear(picture, px, py) * (group.white - group.black)]);
      }
      series.push({ label: one.label, points, style: one.kind === "truth" ? "truth" : one.style, step: one.kind === "captured" });
    }
    const bars = (pixel?.exposures ?? []).map((bar) => [bar.from_ns / 1e6, bar.to_ns / 1e6, bar.shown_dn, `frame ${bar.frame}: ${P.number(bar.dn)} DN`]);
    charts.push(P.chart(place("dn"), { title: "Digital number", x: "time [ms]", y: "DN", series, bars, xRange: range(group) }));
  };

  const voltages = (group, pixel) => {
    const chosen = pixel.solved[Number(solved.value)] ?? pixel.solved[0];
    const ticks = pixel.events.map((event) => [event.t_ns / 1e6, event.on]);
    const series = pixel.solved.map((one) => ({
      label: `V_DC, ${one.label}`, style: one.style, step: one.is_held, points: one.knots.map(([t, v]) => [t / 1e6, v]),
      band: one === chosen ? one.band.map(([t, low, high]) => [t / 1e6, low, high]) : [],
    }));
    if (chosen?.front_end.length) series.push({ label: `V_FE, ${chosen.label}`, style: 6, points: chosen.front_end.map(([t, v]) => [t / 1e6, v]) });
    charts.push(P.chart(place("voltage"), { title: "V_DC, V_FE and events", x: "time [ms]", y: "ln i", series, ticks, xRange: range(group) }));
    const residual = (of, style) => pixel.solved.map((one) => ({ label: one.label, style: one.style, loose: true, points: one[of].map((r) => [r.t_ns / 1e6, r.value]) }));
    charts.push(P.chart(place("frame-residual"), { title: "Frame residual: captured - predicted", x: "time [ms]", y: "DN", series: residual("frame_residuals"), xRange: range(group) }));
    charts.push(P.chart(place("event-residual"), { title: "Event residual: step of V_FE - threshold", x: "time [ms]", y: "ln i", series: residual("event_residuals"), xRange: range(group) }));
  };

  const show = ({ group, x, y }) => {
    now = { group, x, y };
    charts = [];
    column.value = x;
    row.value = y;
    const at = group.holds_pixels ? known(x, y) : -1, pixel = at < 0 ? null : full[at];
    chooser.value = at < 0 ? "" : String(at);
    ["voltage", "frame-residual", "event-residual"].forEach((name) => part(name).replaceChildren());
    part("more").hidden = pixel !== null;
    part("add").textContent = `--pixel ${x},${y}`;
    part("solved-row").hidden = !pixel || pixel.solved.length < 2;
    if (pixel) {
      const kept = solved.value;
      solved.replaceChildren(...pixel.solved.map((one, at) => P.make("option", { value: at }, one.label)));
      solved.value = kept || String(pixel.solved.length - 1);
      voltages(group, pixel);
    }
    part("counts").textContent = pixel ? `${pixel.events.length} events, ${pixel.events.filter((event) => event.on).length} of them ON; ${pixel.exposures.length} exposures` : "";
    brightness(group, x, y, pixel, ++turn);
    P.emit("probed", { group, x: Math.floor(x / group.shrink), y: Math.floor(y / group.shrink) });
  };
  // The table of values at the frame that is looked at.
  const values = async ({ group, instant }) => {
    if (!now || now.group !== group) return;
    const px = Math.floor(now.x / group.shrink), py = Math.floor(now.y / group.shrink);
    const pictures = await Promise.all(group.sequences.map((_, at) => P.picture(group, at, instant)));
    part("values").replaceChildren(
      ...pictures.map((picture, at) => {
        const dn = group.black + P.linear(picture, px, py) * (group.white - group.black);
        return P.make("tr", {}, P.make("th", { scope: "row" }, group.sequences[at].label), P.make("td", { class: "number" }, dn.toFixed(0)), P.make("td", { class: "number" }, P.ms(picture.t_ns)));
      }),
    );
  };
  let last = null;
  P.on("frame", (frame) => {
    last = frame;
    charts.forEach((chart) => chart.cursor(frame.group.instants_ns[frame.instant] / 1e6));
    values(frame);
  });
  P.on("probe", (pixel) => {
    show({ group: pixel.group, x: Math.floor((pixel.x + 0.5) * pixel.group.shrink), y: Math.floor((pixel.y + 0.5) * pixel.group.shrink) });
    if (last) values(last);
  });
  const enter = (x, y) => {
    const group = now?.group ?? P.data.groups[0], whole = (value, most) => Math.min(Math.max(Math.floor(Number(value) || 0), 0), most - 1);
    show({ group, x: whole(x, group.width * group.shrink), y: whole(y, group.height * group.shrink) });
    if (last) values(last);
  };
  [column, row].forEach((input) => input.addEventListener("change", () => enter(column.value, row.value)));
  chooser.addEventListener("input", () => chooser.value !== "" && enter(full[chooser.value].x, full[chooser.value].y));
  solved.addEventListener("input", () => enter(now.x, now.y));
  if (P.data.groups.length) {
    const first = full[0] ?? { x: (P.data.groups[0].width * P.data.groups[0].shrink) / 2, y: (P.data.groups[0].height * P.data.groups[0].shrink) / 2 };
    enter(first.x, first.y);
  }
}
