// Two pictures of one instant over each other: divider, flicker, side by side, difference. Zoom and place are the same for both.
//
// Pictures hold DN as 8-bit codes of the sRGB curve between black and white; a difference is taken between linear values and given in percent of white - black.
{
  // Linear share of white for each code.
  const LINEAR = Float32Array.from({ length: 256 }, (_, code) => {
    const c = code / 255;
    return c <= 0.04045 ? c / 12.92 : ((c + 0.055) / 1.055) ** 2.4;
  });
  // Colours of differences, dark to light, so that grey prints and colour-blind eyes keep the order: less is dark blue, nothing is grey, more is light orange.
  const RAMP = [[8, 29, 88], [34, 94, 168], [120, 120, 120], [230, 150, 70], [255, 240, 200]];
  const ramp = (share) => {
    const at = Math.min(Math.max((share + 1) / 2, 0), 1) * (RAMP.length - 1), low = Math.min(Math.floor(at), RAMP.length - 2);
    return RAMP[low].map((value, channel) => value + (at - low) * (RAMP[low + 1][channel] - value));
  };
  const MOST_HELD = 400;

  // One picture: its image for drawing, its codes for numbers.
  const held = new Map();
  P.picture = (group, sequence, instant) => {
    const frame = group.sequences[sequence].frames[group.sequences[sequence].at[instant]];
    const key = frame.src;
    if (held.has(key)) return held.get(key);
    if (held.size > MOST_HELD) held.delete(held.keys().next().value);
    const image = new Image();
    const ready = new Promise((done) => {
      image.onload = () => {
        const canvas = P.make("canvas", { width: image.width, height: image.height });
        const context = canvas.getContext("2d", { willReadFrequently: true });
        context.drawImage(image, 0, 0);
        done({ canvas, codes: context.getImageData(0, 0, image.width, image.height).data, t_ns: frame.t_ns, frame: frame.frame });
      };
    });
    image.src = frame.src;
    held.set(key, ready);
    return ready;
  };
  P.linear = (picture, x, y) => {
    const at = 4 * (y * picture.canvas.width + x);
    return (LINEAR[picture.codes[at]] + LINEAR[picture.codes[at + 1]] + LINEAR[picture.codes[at + 2]]) / 3;
  };

  const setUp = (root) => {
    const group = P.data.groups[Number(root.dataset.group)];
    const find = (name) => root.querySelector(`[data-part="${name}"]`);
    const [left, right, scrub, divider, zoomer, scale] = ["left", "right", "scrub", "divider", "zoom", "scale"].map(find);
    const canvas = find("canvas"), caption = find("caption"), stage = canvas.parentElement;
    const context = canvas.getContext("2d");
    // What is looked at: the mode, the zoom, the middle of the view in picture pixels, which of two pictures flickers now.
    const view = { mode: "slider", zoom: 1, x: group.width / 2, y: group.height / 2, second: false, pixel: null };
    let shown = null, turn = 0, flicker = null, player = null;

    group.sequences.forEach((one, at) => [left, right].forEach((select) => select.append(P.make("option", { value: at }, one.label))));
    left.value = group.first[0];
    right.value = group.first[1];

    const cut = () => {
      const [w, h] = [group.width / view.zoom, group.height / view.zoom];
      view.x = Math.min(Math.max(view.x, w / 2), group.width - w / 2);
      view.y = Math.min(Math.max(view.y, h / 2), group.height - h / 2);
      return [view.x - w / 2, view.y - h / 2, w, h];
    };
    const difference = (a, b) => {
      const canvas = P.make("canvas", { width: group.width, height: group.height }), context = canvas.getContext("2d");
      const image = context.createImageData(group.width, group.height), full = Number(scale.value) / 100;
      for (let y = 0, at = 0; y < group.height; y++)
        for (let x = 0; x < group.width; x++, at += 4) {
          const [r, g, blue] = ramp((P.linear(a, x, y) - P.linear(b, x, y)) / full);
          image.data.set([r, g, blue, 255], at);
        }
      context.putImageData(image, 0, 0);
      return canvas;
    };
    const label = (text, x, right) => {
      const size = 13 * devicePixelRatio;
      context.font = `600 ${size}px system-ui, sans-serif`;
      const width = context.measureText(text).width + size, from = right ? x - width : x;
      context.fillStyle = "rgba(0,0,0,.7)";
      context.fillRect(from, 0, width, 1.7 * size);
      context.fillStyle = "#fff";
      context.fillText(text, from + size / 2, 1.2 * size);
    };
    const draw = () => {
      if (!shown) return;
      const { a, b } = shown, pair = view.mode === "pair";
      const parts = pair ? 2 : 1, wide = Math.max(1, Math.round(canvas.clientWidth * devicePixelRatio));
      const tall = Math.round((wide / parts) * (group.height / group.width));
      if (canvas.width !== wide || canvas.height !== tall) (canvas.width = wide), (canvas.height = tall);
      context.imageSmoothingEnabled = false;
      const [sx, sy, sw, sh] = cut(), width = wide / parts;
      const put = (picture, from) => context.drawImage(picture, sx, sy, sw, sh, from, 0, width, tall);
      const names = [left, right].map((select) => group.sequences[select.value].label);
      if (view.mode === "difference") {
        put((shown.difference ??= difference(a, b)), 0);
        label(`${names[0]} - ${names[1]}`, 0, false);
      } else if (view.mode === "flicker") {
        put((view.second ? b : a).canvas, 0);
        label(names[Number(view.second)], 0, false);
      } else if (pair) {
        put(a.canvas, 0);
        put(b.canvas, width);
        label(names[0], 0, false);
        label(names[1], wide, true);
      } else {
        const edge = Math.round((wide * divider.value) / 100);
        put(b.canvas, 0);
        context.save();
        context.beginPath();
        context.rect(0, 0, edge, tall);
        context.clip();
        put(a.canvas, 0);
        label(names[0], 0, false);
        context.restore();
        context.save();
        context.beginPath();
        context.rect(edge, 0, wide - edge, tall);
        context.clip();
        label(names[1], wide, true);
        context.restore();
        context.fillStyle = "#fff";
        context.fillRect(edge - devicePixelRatio, 0, 2 * devicePixelRatio, tall);
      }
      if (view.pixel) {
        const step = width / sw;
        context.lineWidth = 2 * devicePixelRatio;
        for (let part = 0; part < parts; part++) {
          const [px, py] = [(view.pixel.x - sx) * step + part * width, (view.pixel.y - sy) * step], room = 3 * devicePixelRatio;
          context.strokeStyle = "#000";
          context.strokeRect(px - room - 1, py - room - 1, step + 2 * room + 2, step + 2 * room + 2);
          context.strokeStyle = "#ffd84d";
          context.strokeRect(px - room, py - room, step + 2 * room, step + 2 * room);
        }
      }
      stage.classList.toggle("zoomed", view.zoom > 1);
    };
    // The picture with its controls fits a screen.
    const size = () => {
      const parts = view.mode === "pair" ? 2 : 1;
      stage.style.maxWidth = `max(18rem, ${((parts * 68 * group.width) / group.height).toFixed(1)}vh)`;
    };
    const load = async () => {
      const mine = ++turn, instant = Number(scrub.value);
      const [a, b] = await Promise.all([left, right].map((select) => P.picture(group, Number(select.value), instant)));
      if (mine !== turn) return;
      shown = { a, b };
      draw();
      const name = (select, picture) => `${group.sequences[select.value].label}: frame ${picture.frame}, ${P.ms(picture.t_ns)}`;
      caption.textContent = `${name(left, a)} | ${name(right, b)}`;
      find("instant").textContent = `${instant + 1} of ${group.instants_ns.length}, ${P.ms(group.instants_ns[instant])}`;
      scrub.setAttribute("aria-valuetext", find("instant").textContent);
      P.emit("instant", group.instants_ns[instant]);
      P.emit("frame", { group, instant });
    };
    const setMode = (mode) => {
      view.mode = mode;
      clearInterval(flicker);
      root.querySelectorAll("[data-mode]").forEach((button) => button.setAttribute("aria-pressed", String(button.dataset.mode === mode)));
      find("divider-row").hidden = mode !== "slider";
      find("scale-row").hidden = mode !== "difference";
      // Two changes a second: under the three at which flashes can harm.
      if (mode === "flicker") flicker = setInterval(() => ((view.second = !view.second), draw()), 500);
      size();
      draw();
    };
    const setZoom = (zoom, at = null) => {
      const next = Math.min(Math.max(zoom, 1), 32);
      if (at) (view.x = at.x + ((view.x - at.x) * view.zoom) / next), (view.y = at.y + ((view.y - at.y) * view.zoom) / next);
      view.zoom = next;
      zoomer.value = Math.log2(next);
      draw();
    };
    const place = (event) => {
      const box = canvas.getBoundingClientRect(), [sx, sy, sw, sh] = cut(), parts = view.mode === "pair" ? 2 : 1;
      const share = (((event.clientX - box.left) / box.width) * parts) % 1;
      return { x: sx + share * sw, y: sy + ((event.clientY - box.top) / box.height) * sh, share: 100 * share, perPixel: box.width / parts / sw };
    };
    const probe = (x, y) => P.emit("probe", { group, x: Math.min(Math.max(x, 0), group.width - 1), y: Math.min(Math.max(y, 0), group.height - 1) });
    const play = (on) => {
      clearInterval(player);
      player = on ? setInterval(() => ((scrub.value = (Number(scrub.value) + 1) % group.instants_ns.length), load()), 120) : null;
      find("play").textContent = on ? "Pause" : "Play";
      find("play").setAttribute("aria-pressed", String(on));
    };

    [left, right, scrub].forEach((control) => control.addEventListener("input", load));
    divider.addEventListener("input", draw);
    zoomer.addEventListener("input", () => setZoom(2 ** zoomer.value));
    scale.addEventListener("input", () => (delete shown.difference, legend(), draw()));
    find("swap").addEventListener("click", () => (([left.value, right.value] = [right.value, left.value]), load()));
    find("reset").addEventListener("click", () => ((view.x = group.width / 2), (view.y = group.height / 2), setZoom(1)));
    find("play").addEventListener("click", () => play(player === null));
    root.querySelectorAll("[data-mode]").forEach((button) => button.addEventListener("click", () => setMode(button.dataset.mode)));

    // Mouse, pen and fingers: a drag moves the divider, or the view when it is zoomed; two fingers zoom; a press without a drag probes.
    const fingers = new Map();
    let drag = null, spread = null;
    canvas.addEventListener("pointerdown", (event) => {
      fingers.set(event.pointerId, event);
      drag = { x: event.clientX, y: event.clientY, moved: false, fromX: view.x, fromY: view.y, divider: Math.abs(place(event).share - divider.value) < 4 };
      spread = null;
      canvas.setPointerCapture(event.pointerId);
    });
    canvas.addEventListener("pointermove", (event) => {
      if (!fingers.has(event.pointerId) || !drag) return;
      fingers.set(event.pointerId, event);
      if (fingers.size === 2) {
        const [one, other] = [...fingers.values()], now = Math.hypot(one.clientX - other.clientX, one.clientY - other.clientY);
        if (spread) setZoom((view.zoom * now) / spread);
        spread = now;
        drag.moved = true;
        return;
      }
      if (Math.hypot(event.clientX - drag.x, event.clientY - drag.y) > 4) drag.moved = true;
      if (!drag.moved) return;
      if (view.mode === "slider" && (drag.divider || view.zoom === 1)) divider.value = place(event).share;
      else {
        const { perPixel } = place(event);
        view.x = drag.fromX - (event.clientX - drag.x) / perPixel;
        view.y = drag.fromY - (event.clientY - drag.y) / perPixel;
      }
      draw();
    });
    const lift = (event) => {
      fingers.delete(event.pointerId);
      if (event.type === "pointerup" && drag && !drag.moved) {
        const { x, y } = place(event);
        probe(Math.floor(x), Math.floor(y));
      }
      if (fingers.size === 0) drag = null;
    };
    canvas.addEventListener("pointerup", lift);
    canvas.addEventListener("pointercancel", lift);
    canvas.addEventListener("wheel", (event) => {
      // A page that is scrolled past a picture goes on scrolling.
      if (!event.ctrlKey && document.activeElement !== canvas) return;
      event.preventDefault();
      setZoom(view.zoom * 2 ** (-event.deltaY / 300), place(event));
    }, { passive: false });
    canvas.addEventListener("keydown", (event) => {
      const step = 10 / view.zoom, pixel = view.pixel ?? { x: Math.floor(view.x), y: Math.floor(view.y) };
      const move = (dx, dy) => (event.shiftKey ? probe(pixel.x + dx, pixel.y + dy) : ((view.x += dx * step), (view.y += dy * step), draw()));
      const frame = (by) => ((scrub.value = Number(scrub.value) + by), load());
      const keys = {
        ArrowLeft: () => move(-1, 0), ArrowRight: () => move(1, 0), ArrowUp: () => move(0, -1), ArrowDown: () => move(0, 1),
        "+": () => setZoom(view.zoom * 1.5), "-": () => setZoom(view.zoom / 1.5), 0: () => setZoom(1), ",": () => frame(-1), ".": () => frame(1),
        s: () => setMode("slider"), f: () => setMode("flicker"), b: () => setMode("pair"), d: () => setMode("difference"), x: () => find("swap").click(),
        Enter: () => probe(pixel.x, pixel.y),
      };
      if (!keys[event.key] || event.ctrlKey || event.metaKey || event.altKey) return;
      event.preventDefault();
      keys[event.key]();
    });
    const legend = () => {
      const bar = find("ramp"), context = bar.getContext("2d");
      for (let x = 0; x < bar.width; x++) {
        context.fillStyle = `rgb(${ramp((2 * x) / (bar.width - 1) - 1).map(Math.round).join(",")})`;
        context.fillRect(x, 0, 1, bar.height);
      }
      find("ramp-low").textContent = `-${scale.value} %`;
      find("ramp-high").textContent = `+${scale.value} %`;
    };
    P.on("probed", (pixel) => ((view.pixel = pixel.group === group ? pixel : null), draw()));
    P.onWidth(canvas.parentElement, draw);
    legend();
    setMode("slider");
    load();
  };
  document.querySelectorAll("[data-group]").forEach(setUp);
}
