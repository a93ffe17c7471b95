// A recording in time: events around an instant, and the picture of each sequence whose exposure is nearest to it. A slider, keys or the clock move the instant.
{
  const root = document.getElementById("player");
  const part = (name, within = root) => within.querySelector(`[data-part="${name}"]`);
  const { from_ns: FROM, to_ns: TO, films, events, first } = P.data;
  const LENGTH = Math.max(TO - FROM, 1);
  const MOST_HELD = 300;
  // The less often a pixel had events, the fainter it is drawn: what is left of the paper after so many.
  const LEFT = 0.4;
  const [slider, now, rate, line, speed, span, window_, over] = ["time", "now", "rate", "line", "speed", "span", "window", "over"].map((name) => part(name));
  // The instant, ns after FROM; what is drawn of the time line while it is dragged.
  const state = { at: 0, playing: false, last: null, drag: null };

  // Numbers of LEB128: groups of seven bits, the lowest first.
  const bytes = (text) => {
    const raw = atob(text), all = new Uint8Array(raw.length);
    for (let k = 0; k < raw.length; k++) all[k] = raw.charCodeAt(k);
    return all;
  };
  // Sums up to each of `count` numbers.
  const sums = (text, count) => {
    const all = bytes(text), sum = new Float64Array(count + 1);
    for (let k = 0, at = 0; k < count; k++) {
      let number = 0, scale = 1, byte;
      do {
        byte = all[at++];
        number += (byte & 127) * scale;
        scale *= 128;
      } while (byte > 127);
      sum[k + 1] = sum[k] + number;
    }
    return sum;
  };
  const packed = events && {
    ...events, places: bytes(events.places), starts: sums(events.lengths, events.slices), on: sums(events.on_counts, events.slices), off: sums(events.off_counts, events.slices),
    counts: new Uint16Array(2 * events.width * events.height),
  };
  const STEP = packed ? packed.slice_ns : 10 ** Math.max(3, Math.floor(Math.log10(LENGTH)) - 3);
  const slice = (ns) => Math.min(Math.max(Math.round((ns + FROM - packed.start_ns) / packed.slice_ns), 0), packed.slices);
  const width_ns = () => (window_ ? Number(window_.value) : 50 * STEP);

  const option = (select, value, text) => select.append(P.make("option", { value }, text));
  const ms = (ns, digits = 3) => ((ns + FROM) / 1e6).toFixed(digits);
  const per_second = (rate) => {
    const [scale, unit] = rate >= 1e6 ? [1e6, "M events/s"] : rate >= 1e3 ? [1e3, "k events/s"] : [1, "events/s"];
    return `${P.number(rate / scale, 3)} ${unit}`;
  };

  // Colours of the page's style, light or dark; of ON and OFF their channels as well.
  const probe = P.make("span", { hidden: "" });
  root.append(probe);
  let shade = null, inks = null;
  const recolour = () => {
    const of = (name) => {
      probe.style.color = `var(--${name})`;
      return getComputedStyle(probe).color;
    };
    shade = { on: of("c1"), off: of("c0"), text: of("soft"), edge: of("edge"), mark: of("mark"), panel: of("panel") };
    const channels = (colour) => colour.match(/[\d.]+/g).slice(0, 3).map(Number);
    inks = { on: channels(shade.on), off: channels(shade.off) };
    // At once: a page that is printed has no next frame.
    render();
  };

  const paint = (from, to) => {
    const { counts, places, starts } = packed;
    counts.fill(0);
    for (let k = from; k < to; k++) {
      let place = 0, at = starts[k];
      while (at < starts[k + 1]) {
        let number = 0, scale = 1, byte;
        do {
          byte = places[at++];
          number += (byte & 127) * scale;
          scale *= 128;
        } while (byte > 127);
        place += number;
        counts[place]++;
      }
    }
    const canvas = part("events"), context = canvas.getContext("2d"), image = context.createImageData(packed.width, packed.height), data = image.data;
    for (let pixel = 0, at = 0; at < data.length; pixel += 2, at += 4) {
      const off = counts[pixel], on = counts[pixel + 1];
      if (!on && !off) continue;
      const share = on / (on + off);
      for (let channel = 0; channel < 3; channel++) data[at + channel] = share * inks.on[channel] + (1 - share) * inks.off[channel];
      data[at + 3] = 255 * (1 - LEFT ** (on + off));
    }
    context.putImageData(image, 0, 0);
  };

  const draw_events = () => {
    const half = width_ns() / 2, from = slice(state.at - half), to = slice(state.at + half);
    paint(from, to);
    const [on, off] = [packed.on[to] - packed.on[from], packed.off[to] - packed.off[from]];
    const drawn = packed.share < 1 ? `; about ${P.number(100 * packed.share, 3)} % of them are drawn` : "";
    part("events-caption").textContent = `${on + off} events from ${ms(from * packed.slice_ns + packed.start_ns - FROM, 2)} to ${ms(to * packed.slice_ns + packed.start_ns - FROM, 2)} ms: ${on} ON, ${off} OFF${drawn}`;
    rate.textContent = per_second((1e9 * (on + off)) / Math.max((to - from) * packed.slice_ns, 1));
  };

  // Pictures in the order of the middles of their exposures.
  const middle = (frame) => (frame.from_ns + frame.to_ns) / 2 - FROM;
  films.forEach((film) => film.frames.sort((a, b) => middle(a) - middle(b)));
  const nearest = (frames, at) => {
    let low = 0, high = frames.length - 1;
    while (low < high) {
      const k = (low + high) >> 1;
      if (middle(frames[k]) < at) low = k + 1;
      else high = k;
    }
    return low > 0 && at - middle(frames[low - 1]) <= middle(frames[low]) - at ? low - 1 : low;
  };
  const held = new Map();
  const picture = (frame) => {
    if (!frame) return null;
    if (!held.has(frame.src)) {
      if (held.size > MOST_HELD) held.delete(held.keys().next().value);
      const image = new Image();
      image.onload = draw;
      image.src = frame.src;
      held.set(frame.src, image);
    }
    return held.get(frame.src);
  };
  const panels = [...root.querySelectorAll("[data-film]")].map((figure) => {
    const choice = part("choice", figure), kind = figure.dataset.film;
    films.forEach((film, at) => (film.kind === kind || (kind === "method" && film.kind === "truth")) && option(choice, at, film.label));
    if (kind === "method" && [...choice.options].some((one) => Number(one.value) === first)) choice.value = first;
    choice.addEventListener("input", () => (size(), draw()));
    return { figure, choice, canvas: part("picture", figure), caption: part("caption", figure), film: () => films[Number(choice.value)] };
  });
  const draw_film = (panel) => {
    const film = panel.film(), k = nearest(film.frames, state.at), frame = film.frames[k], image = picture(frame);
    picture(film.frames[k + 1]);
    const away = middle(frame) - state.at, where = Math.abs(away) < 500 ? "at the instant" : `${(Math.abs(away) / 1e6).toFixed(3)} ms ${away > 0 ? "after" : "before"} the instant`;
    panel.caption.textContent = `${film.label}, frame ${frame.frame}: exposed from ${ms(frame.from_ns - FROM)} to ${ms(frame.to_ns - FROM)} ms${film.row_time_ns ? " (row 0)" : ""}; its middle is ${where}`;
    // The picture before stays until this one is decoded.
    if (!image.complete || !image.naturalWidth) return;
    const { canvas } = panel, context = canvas.getContext("2d");
    context.imageSmoothingEnabled = false;
    context.drawImage(image, 0, 0, canvas.width, canvas.height);
    if (over?.checked) context.drawImage(part("events"), 0, 0, canvas.width, canvas.height);
  };
  // A panel has as many dots as its pictures, or as the events over them, and fits a screen.
  const size = () => {
    const fit = (canvas) => (canvas.parentElement.style.maxWidth = `max(18rem, ${((58 * canvas.width) / canvas.height).toFixed(1)}vh)`);
    panels.forEach(({ canvas, film }) => {
      const { width, height } = film(), scale = over?.checked ? Math.max(1, Math.round(packed.width / width)) : 1;
      if (canvas.width !== width * scale || canvas.height !== height * scale) (canvas.width = width * scale), (canvas.height = height * scale);
      fit(canvas);
    });
    if (packed) fit(part("events"));
  };

  // The part of time that the time line shows.
  const view = () => {
    const wide = Math.min(Number(span.value), LENGTH), from = Math.min(Math.max(state.at - wide / 2, 0), LENGTH - wide);
    return { from, wide };
  };
  const draw_line = () => {
    const context = line.getContext("2d"), dots = devicePixelRatio;
    const [width, height] = [line.clientWidth, line.clientHeight];
    if (line.width !== Math.round(width * dots) || line.height !== Math.round(height * dots)) (line.width = Math.round(width * dots)), (line.height = Math.round(height * dots));
    context.setTransform(dots, 0, 0, dots, 0, 0);
    context.clearRect(0, 0, width, height);
    const { from, wide } = state.drag ?? view(), left = 96, right = width - 6, bottom = height - 20;
    const x = (ns) => left + ((ns - from) / wide) * (right - left);
    context.font = "12px system-ui, sans-serif";
    const text = (words, at, y, align) => {
      context.textAlign = align;
      context.fillStyle = shade.text;
      context.fillText(words, at, y);
    };
    const rows = panels.map((panel) => ({ film: panel.film(), title: panel.figure.dataset.film === "captured" ? "frames" : "pictures" }));
    const top = 15, tall = bottom - 20 * rows.length, half_height = (tall - top) / 2 - 1, base = top + half_height;
    if (packed) {
      const half = width_ns() / 2;
      context.fillStyle = shade.panel;
      context.fillRect(Math.max(x(state.at - half), left), 0, Math.max(1, Math.min(x(state.at + half), right) - Math.max(x(state.at - half), left)), bottom);
      // For each column of dots the mean rate of its time; slices that are longer than a column fill several.
      const columns = [];
      for (let column = left; column < right; column++) {
        const [a, b] = [column, column + 1].map((at) => ((at - left) / (right - left)) * wide + from + FROM - packed.start_ns).map((ns) => ns / packed.slice_ns);
        const low = Math.min(Math.max(Math.floor(a), 0), packed.slices), high = Math.min(Math.max(Math.ceil(b), low), packed.slices);
        const per = (sum) => (high > low ? (sum[high] - sum[low]) / (high - low) : 0);
        columns.push([per(packed.on), per(packed.off)]);
      }
      const most = columns.reduce((most, [on, off]) => Math.max(most, on, off), 0) || 1;
      columns.forEach(([on, off], k) => {
        context.fillStyle = shade.on;
        context.fillRect(left + k, base - (on / most) * half_height, 1, (on / most) * half_height);
        context.fillStyle = shade.off;
        context.fillRect(left + k, base, 1, (off / most) * half_height);
      });
      text("ON", left - 8, base - 4, "right");
      text("OFF", left - 8, base + 14, "right");
      text(`to ${per_second((1e9 * most) / packed.slice_ns)}`, left + 3, 11, "left");
    }
    rows.forEach(({ film, title }, k) => {
      const y = tall + 20 * k, frame = film.frames[nearest(film.frames, state.at)];
      text(title, left - 8, y + 14, "right");
      const bar = ([start, end], colour, grow) => {
        const [a, b] = [x(start - FROM), x(end - FROM)].map((at) => Math.min(Math.max(at, left), right));
        if (b < left || a > right || (a === b && (a === left || a === right))) return;
        context.fillStyle = colour;
        context.fillRect(a, y + 4 - grow, Math.max(b - a - (b - a > 3 ? 1 : 0), 1), 10 + 2 * grow);
      };
      film.marks.forEach((mark) => bar(mark, shade.edge, 0));
      bar([frame.from_ns, frame.to_ns], shade.mark, 2);
    });
    context.strokeStyle = shade.edge;
    context.beginPath();
    context.moveTo(left, bottom + 0.5);
    context.lineTo(right, bottom + 0.5);
    context.stroke();
    for (const [value, words] of P.steps((from + FROM) / 1e6, (from + wide + FROM) / 1e6, (right - left) / 90)) {
      const at = x(value * 1e6 - FROM);
      context.fillStyle = shade.edge;
      context.fillRect(at, bottom, 1, 4);
      text(words, Math.min(Math.max(at, left + 8), right - 14), bottom + 16, "center");
    }
    text("ms", left - 8, bottom + 16, "right");
    context.fillStyle = shade.mark;
    context.fillRect(x(state.at) - 1, 0, 2, bottom);
  };

  let waiting = false;
  const render = () => {
    waiting = false;
    now.textContent = `${ms(state.at)} ms`;
    if (packed) draw_events();
    panels.forEach(draw_film);
    draw_line();
    slider.value = Math.round(state.at / STEP);
    slider.setAttribute("aria-valuetext", packed ? `${now.textContent}, ${rate.textContent}` : now.textContent);
  };
  const draw = () => {
    if (!waiting) requestAnimationFrame(render);
    waiting = true;
  };

  const go = (at) => {
    state.at = Math.min(Math.max(at, 0), LENGTH);
    draw();
  };
  const play = (on) => {
    if (on && state.at >= LENGTH) state.at = 0;
    state.playing = on;
    state.last = null;
    part("play").textContent = on ? "Pause" : "Play";
    part("play").setAttribute("aria-pressed", String(on));
    if (on) requestAnimationFrame(tick);
  };
  const tick = (clock) => {
    if (!state.playing) return;
    // A page that was hidden goes on where it was.
    if (state.last !== null) go(state.at + Math.min(clock - state.last, 250) * 1e6 * Number(speed.value));
    state.last = clock;
    if (state.at >= LENGTH) play(false);
    else requestAnimationFrame(tick);
  };
  // From frame to frame, by their middles.
  const jump = (by) => {
    if (!panels.length) return;
    const { frames } = panels[0].film(), k = nearest(frames, state.at), is_there = Math.abs(middle(frames[k]) - state.at) < STEP / 2;
    const beyond = is_there || (by > 0 ? middle(frames[k]) < state.at : middle(frames[k]) > state.at);
    go(middle(frames[Math.min(Math.max(k + (beyond ? by : 0), 0), frames.length - 1)]));
  };

  slider.max = Math.ceil(LENGTH / STEP);
  slider.addEventListener("input", () => go(Number(slider.value) * STEP));
  part("play").addEventListener("click", () => play(!state.playing));
  part("back").addEventListener("click", () => jump(-1));
  part("next").addEventListener("click", () => jump(1));
  part("back").parentElement.hidden = !panels.length;
  if (over) over.addEventListener("input", () => (size(), draw()));

  const SPEEDS = [10, 5, 2, 1, 1 / 2, 1 / 5, 1 / 10, 1 / 20, 1 / 50, 1 / 100, 1 / 200, 1 / 500, 1 / 1000];
  SPEEDS.forEach((value) => option(speed, value, value === 1 ? "real time" : value > 1 ? `${value} times faster` : `${Math.round(1 / value)} times slower`));
  // First at the speed that takes some ten seconds, and not faster than it was.
  const long = (value) => Math.abs(Math.log(LENGTH / value / 1e10));
  speed.value = SPEEDS.filter((value) => value <= 1).reduce((best, value) => (long(value) < long(best) ? value : best));
  const short = (ns) => (ns >= 1e9 ? `${ns / 1e9} s` : `${ns / 1e6} ms`);
  if (packed) {
    const windows = [0.1, 0.2, 0.5, 1, 2, 5, 10, 20, 50, 100, 200, 500, 1000].map((value) => value * 1e6).filter((ns) => ns % packed.slice_ns === 0 && ns <= Math.max(LENGTH, packed.slice_ns));
    if (!windows.length) windows.push(packed.slice_ns);
    windows.forEach((ns) => option(window_, ns, short(ns)));
    // First a window in which three of a thousand pixels have an event, on the average; from 1 to 20 ms.
    const mean = (ns) => ((packed.on[packed.slices] + packed.off[packed.slices]) * ns) / LENGTH;
    const seen = (ns) => ns >= 1e6 && (ns >= 2e7 || mean(ns) >= 0.003 * packed.width * packed.height);
    window_.value = windows.find(seen) ?? windows[windows.length - 1];
    window_.addEventListener("input", draw);
  }
  const spans = [LENGTH, 1e10, 1e9, 2e8, 5e7, 1e7, 2e6].filter((ns, at) => at === 0 || ns < LENGTH);
  spans.forEach((ns, at) => option(span, ns, at === 0 ? "whole" : short(ns)));
  // First so much of it that frames can be seen one by one.
  const most = Math.max(1, ...films.map((film) => (film.kind === "captured" ? film.marks.length : 1)));
  span.value = spans.find((ns) => (most * ns) / LENGTH < 150) ?? spans[spans.length - 1];
  span.addEventListener("input", draw);

  const touch = (event) => {
    const box = line.getBoundingClientRect();
    go(state.drag.from + ((event.clientX - box.left - 96) / (box.width - 102)) * state.drag.wide);
  };
  line.addEventListener("pointerdown", (event) => {
    state.drag = view();
    line.setPointerCapture(event.pointerId);
    touch(event);
  });
  line.addEventListener("pointermove", (event) => state.drag && touch(event));
  ["pointerup", "pointercancel"].forEach((name) => line.addEventListener(name, () => ((state.drag = null), draw())));

  document.addEventListener("keydown", (event) => {
    const on = event.target, is_range = on.matches("input[type=range]");
    if (event.ctrlKey || event.metaKey || event.altKey || on.matches("select, textarea") || (on.matches("input") && !is_range && event.key !== "ArrowLeft" && event.key !== "ArrowRight")) return;
    if (event.key === " " && on.matches("button, a, summary")) return;
    const step = event.shiftKey ? STEP : Math.max(width_ns(), STEP);
    const everywhere = { " ": () => play(!state.playing), ArrowLeft: () => go(state.at - step), ArrowRight: () => go(state.at + step) };
    const inside = { ",": () => jump(-1), ".": () => jump(1), Home: () => go(0), End: () => go(LENGTH) };
    const call = everywhere[event.key] ?? (root.contains(on) ? inside[event.key] : null);
    if (!call) return;
    event.preventDefault();
    call();
  });
  P.on("theme", recolour);
  ["(prefers-color-scheme: dark)", "print"].forEach((media) => matchMedia(media).addEventListener("change", recolour));
  P.onWidth(line, draw);
  size();
  recolour();
  // First the middle of an exposure, so that events, frames and pictures are of one moment.
  go(LENGTH / 2);
  if (panels.length) go(middle(panels[0].film().frames[nearest(panels[0].film().frames, state.at)]));
}
