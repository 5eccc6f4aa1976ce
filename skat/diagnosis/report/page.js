"use strict";
(() => {
  const report = document.querySelector(".skat-report");

  // Tables: a button in each header sorts by its column, first upwards, then downwards.
  for (const table of report.querySelectorAll("table")) {
    const body = table.tBodies[0];
    if (body.rows.length < 2) continue;
    const headers = [...table.tHead.rows[0].cells];
    headers.forEach((header, column) => {
      const button = document.createElement("button");
      button.type = "button";
      button.append(...header.childNodes);
      header.append(button);
      button.addEventListener("click", () => {
        const down = header.getAttribute("aria-sort") === "ascending";
        headers.forEach((other) => other.removeAttribute("aria-sort"));
        header.setAttribute("aria-sort", down ? "descending" : "ascending");
        const rows = [...body.rows];
        rows.sort((first, second) => (down ? -1 : 1) * compare(first.cells[column], second.cells[column]));
        body.append(...rows);
      });
    });
  }

  function compare(first, second) {
    const [one, other] = [first, second].map((cell) => cell.dataset.key ?? cell.textContent.trim());
    const [left, right] = [one, other].map((key) => (key === "" ? NaN : Number(key)));
    if (Number.isNaN(left) !== Number.isNaN(right)) return Number.isNaN(left) ? 1 : -1;
    return Number.isNaN(left) ? one.localeCompare(other, undefined, { numeric: true }) : left - right || 0;
  }

  // Signals: zoom in time by keyboard, buttons or dragging; all channels of an episode move together.
  const CLOSEST = 1 / 64;
  const SIZE = 1000;
  for (const group of report.querySelectorAll(".signals")) zoomable(group);

  function zoomable(group) {
    const plots = [...group.querySelectorAll(".plot")].map(readPlot);
    let start = 0;
    let width = 1;
    const tools = document.createElement("div");
    tools.className = "tools";
    const said = document.createElement("output");
    said.setAttribute("aria-live", "polite");
    const actions = [
      ["+", "Zoom in", () => zoom(0.5)],
      ["\u2212", "Zoom out", () => zoom(2)],
      ["\u2190", "Earlier", () => move(-0.25)],
      ["\u2192", "Later", () => move(0.25)],
      ["all", "Show all of it", () => show(0, 1)],
    ];
    const buttons = actions.map(([text, label, act]) => {
      const button = document.createElement("button");
      button.type = "button";
      button.textContent = text;
      button.title = label;
      button.setAttribute("aria-label", label);
      button.addEventListener("click", act);
      return button;
    });
    tools.append(...buttons, said);
    group.prepend(tools);
    group.tabIndex = 0;
    group.setAttribute("aria-label", `${group.dataset.label}. Plus and minus zoom, arrows move, 0 shows all.`);
    group.addEventListener("keydown", (event) => {
      if (event.ctrlKey || event.metaKey || event.altKey) return;
      const act = {
        "+": () => zoom(0.5), "=": () => zoom(0.5), "-": () => zoom(2), "0": () => show(0, 1),
        ArrowLeft: () => move(-0.25), ArrowRight: () => move(0.25),
      }[event.key];
      if (act && (width < 1 || !event.key.startsWith("Arrow"))) { act(); event.preventDefault(); }
    });
    for (const plot of plots) draggable(plot);
    show(0, 1);

    function zoom(factor) {
      const wanted = width * factor;
      show(start + (width - wanted) / 2, wanted);
    }
    function move(share) { show(start + share * width, width); }
    function show(from, wide) {
      width = Math.min(1, Math.max(CLOSEST, wide));
      start = Math.min(1 - width, Math.max(0, from));
      for (const plot of plots) drawPlot(plot, start, width);
      const [first, last] = plots[0].x;
      const ends = [start, start + width].map((share) => first + share * (last - first));
      const digits = Math.max(0, 1 - Math.floor(Math.log10(ends[1] - ends[0])));
      said.textContent = width < 1 ? `${ends[0].toFixed(digits)} to ${ends[1].toFixed(digits)}, ${plots[0].unit}` : "";
      buttons[0].disabled = width <= CLOSEST;
      buttons[1].disabled = buttons[4].disabled = width >= 1;
      buttons[2].disabled = start <= 0;
      buttons[3].disabled = start + width >= 1;
    }
    function draggable(plot) {
      let from = null;
      const share = (event) => {
        const box = plot.svg.getBoundingClientRect();
        return start + (width * Math.min(Math.max(event.clientX - box.left, 0), box.width)) / box.width;
      };
      plot.svg.addEventListener("pointerdown", (event) => {
        if (event.pointerType === "mouse" && event.button === 0) { from = share(event); plot.svg.setPointerCapture(event.pointerId); }
      });
      plot.svg.addEventListener("pointerup", (event) => {
        if (from === null) return;
        const to = share(event);
        if (Math.abs(to - from) > 0.02 * width) show(Math.min(from, to), Math.abs(to - from));
        from = null;
      });
      plot.svg.addEventListener("dblclick", () => show(0, 1));
    }
  }

  function readPlot(element) {
    const svg = element.querySelector("svg");
    return {
      svg, grid: svg.querySelector(".grid"),
      across: element.querySelector(".x"), up: element.querySelector(".y"),
      x: [Number(element.dataset.left), Number(element.dataset.right)],
      y: [Number(element.dataset.low), Number(element.dataset.high)],
      unit: element.querySelector(".across").textContent,
      points: null,
    };
  }

  // A window of the plot: the drawing stays, only what is seen of it and the ticks change.
  function drawPlot(plot, start, width) {
    let [top, height] = [0, SIZE];
    if (width < 1) {
      plot.points ??= [...plot.svg.querySelectorAll(".line")].flatMap((path) =>
        [...path.getAttribute("d").matchAll(/([-\d.]+) ([-\d.]+)/g)].map((pair) => [Number(pair[1]), Number(pair[2])]));
      const seen = plot.points.filter(([x]) => x >= SIZE * start && x <= SIZE * (start + width)).map(([, y]) => y);
      if (seen.length > 1) {
        const low = Math.max(0, Math.min(...seen));
        const high = Math.min(SIZE, Math.max(...seen));
        const pad = Math.max(0.06 * (high - low), 2);
        [top, height] = [low - pad, Math.max(high - low, 0) + 2 * pad];
      }
    }
    plot.svg.setAttribute("viewBox", `${SIZE * start} ${top} ${SIZE * width} ${height}`);
    const [left, right] = plot.x;
    const [low, high] = plot.y;
    const acrossTicks = ticks(left + start * (right - left), left + (start + width) * (right - left));
    const upTicks = ticks(high - ((top + height) / SIZE) * (high - low), high - (top / SIZE) * (high - low));
    const put = (place, list, side, turned) => place.replaceChildren(...list.map(({ share, text }) => {
      const label = document.createElement("span");
      label.textContent = text;
      label.style[side] = `${100 * (turned ? 1 - share : share)}%`;
      return label;
    }));
    put(plot.across, acrossTicks, "left", false);
    put(plot.up, upTicks, "top", true);
    const lines = acrossTicks.map(({ share }) => `M${SIZE * (start + share * width)} ${top}v${height}`);
    lines.push(...upTicks.map(({ share }) => `M${SIZE * start} ${top + (1 - share) * height}h${SIZE * width}`));
    plot.grid.setAttribute("d", lines.join(""));
  }

  function ticks(low, high) {
    const rough = (high - low) / 5;
    const power = 10 ** Math.floor(Math.log10(rough));
    const step = power * [1, 2, 2.5, 5, 10].find((one) => one * power >= rough * 0.999);
    const digits = Math.max(0, Math.ceil(-Math.log10(step)) + (/^2\.5/.test(String(step / power)) ? 1 : 0));
    const found = [];
    for (let at = Math.ceil(low / step - 1e-9); at * step <= high + 1e-9 * step; at++) {
      found.push({ share: (at * step - low) / (high - low), text: String(Number((at * step).toFixed(digits))).replace("-", "\u2212") });
    }
    return found;
  }

  // Paper shows what is folded away.
  let opened = [];
  window.addEventListener("beforeprint", () => {
    opened = [...report.querySelectorAll("details:not([open])")];
    opened.forEach((one) => { one.open = true; });
  });
  window.addEventListener("afterprint", () => opened.forEach((one) => { one.open = false; }));
})();
