// Helpers that all scripts share, the theme switch and the copy buttons. `P` is what the scripts pass to each other.
const P = { data: JSON.parse(document.getElementById("page-data").textContent), listeners: {} };

// Calls everybody who asked for `name`.
P.on = (name, call) => (P.listeners[name] ??= []).push(call);
P.emit = (name, value) => (P.listeners[name] ?? []).forEach((call) => call(value));

// An element with attributes and children; texts never become markup.
P.make = (name, attributes = {}, ...children) => {
  const element = document.createElement(name);
  Object.entries(attributes).forEach(([key, value]) => value !== null && element.setAttribute(key, value));
  element.append(...children);
  return element;
};
P.svg = (name, attributes = {}, text = null) => {
  const element = document.createElementNS("http://www.w3.org/2000/svg", name);
  Object.entries(attributes).forEach(([key, value]) => element.setAttribute(key, value));
  if (text !== null) element.textContent = text;
  return element;
};

// Calls when an element has another size, after the page is laid out.
P.onWidth = (element, call) => new ResizeObserver(() => requestAnimationFrame(call)).observe(element);

// A number as people write it: four digits that count.
P.number = (value, digits = 4) => {
  if (value === null || !Number.isFinite(value)) return "-";
  const text = value.toPrecision(digits);
  return text.includes("e") ? String(Number(text)) : text.replace(/(\.\d*?)0+$/, "$1").replace(/\.$/, "");
};
// Round steps: 1, 2 or 5 times a power of ten, some `count` of them, with their texts.
P.steps = (low, high, count) => {
  const rough = (high - low) / Math.max(count, 1);
  const power = 10 ** Math.floor(Math.log10(rough));
  const step = [1, 2, 5, 10].map((k) => k * power).find((step) => step >= rough * 0.999);
  const values = [];
  for (let k = Math.ceil(low / step - 1e-9); k * step <= high + 1e-9 * step; k++) values.push(k * step);
  const digits = Math.max(0, Math.min(6, -Math.floor(Math.log10(step) + 1e-9)));
  return values.map((value) => [value, value.toFixed(digits)]);
};
P.ms = (ns) => `${(ns / 1e6).toFixed(3)} ms`;

// Theme: as the system has it, light, dark. Nothing is stored.
{
  const button = document.getElementById("theme");
  const names = ["system", "light", "dark"];
  let at = 0;
  button.hidden = false;
  button.addEventListener("click", () => {
    at = (at + 1) % names.length;
    if (names[at] === "system") delete document.documentElement.dataset.theme;
    else document.documentElement.dataset.theme = names[at];
    button.textContent = `Theme: ${names[at]}`;
    P.emit("theme", names[at]);
  });
}

// Copy buttons: `data-copy` names an entry of data.copies. Pages opened from disk may have no clipboard: then the text is shown, selected.
document.querySelectorAll("button[data-copy]").forEach((button) => {
  const name = button.textContent;
  button.addEventListener("click", async () => {
    const text = P.data.copies[Number(button.dataset.copy)];
    try {
      await navigator.clipboard.writeText(text);
      button.textContent = "Copied";
    } catch {
      const place = button.closest(".controls");
      let area = place.nextElementSibling;
      if (area?.tagName !== "TEXTAREA") place.after((area = P.make("textarea", { rows: 8, readonly: "", "aria-label": "Text to copy", style: "width:100%" })));
      area.value = text;
      area.focus();
      area.select();
      button.textContent = "Select and copy";
    }
    setTimeout(() => (button.textContent = name), 2500);
  });
});
