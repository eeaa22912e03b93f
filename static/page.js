// What the page does beyond viser: pictures that answer to the pointer, buttons in HTML, the
// browser's wish for dark, its size, and the clipboard. Everything goes to the server through one
// text field, whose value holds the latest actions and the latest place of the pointer.
(() => {
  if (window.scanloomPage) return;
  window.scanloomPage = true;

  const CHANNEL = "page events";
  // viser sends a field's latest value every 50 ms: actions stay in it long enough to be seen.
  const KEPT_ACTIONS = 8;
  const CLICK_PX = 4;
  // Places of a stroke in one action: all actions together must fit into the field.
  const STROKE_PLACES = 48;
  const SVG = "http://www.w3.org/2000/svg";
  const setValue = Object.getOwnPropertyDescriptor(HTMLInputElement.prototype, "value").set;
  const actions = [];
  let number = 0;
  let pointer = null;
  let held = null;

  function channel() {
    for (const label of document.querySelectorAll("label")) {
      if (label.textContent !== CHANNEL) continue;
      let row = label;
      while (row && !row.querySelector("input")) row = row.parentElement;
      return row && row.querySelector("input");
    }
    return null;
  }

  // viser takes back the address of a picture as soon as the next one is there, which may be before
  // the browser has begun to load it.
  const LOADING_MS = 2000;
  // Without "window." it is the document's own URL here.
  const revoke = window.URL.revokeObjectURL.bind(window.URL);
  window.URL.revokeObjectURL = (address) => setTimeout(() => revoke(address), LOADING_MS);

  let later = 0;
  function send() {
    clearTimeout(later);
    const input = channel();
    if (!input) {
      // The panels are being built anew.
      later = setTimeout(send, 20);
      return;
    }
    setValue.call(input, JSON.stringify({ actions, pointer }));
    input.dispatchEvent(new Event("input", { bubbles: true }));
  }

  function act(action) {
    actions.push({ ...action, number: ++number });
    actions.splice(0, actions.length - KEPT_ACTIONS);
    send();
  }

  // A picture is the image right after an element with its name.
  function nameOf(image) {
    const before = image.parentElement?.parentElement?.previousElementSibling;
    return before?.querySelector("[data-picture]") ?? null;
  }

  function placeOn(image, event) {
    const box = image.getBoundingClientRect();
    return {
      x_px: ((event.clientX - box.left) / box.width) * image.naturalWidth - 0.5,
      y_px: ((event.clientY - box.top) / box.height) * image.naturalHeight - 0.5,
    };
  }

  function point(image, kind, event) {
    const picture = nameOf(image).dataset.picture;
    pointer = { picture, kind, ...placeOn(image, event), number: ++number };
    send();
  }

  function leave() {
    if (pointer === null || pointer.kind === "leave") return;
    pointer = { ...pointer, kind: "leave", number: ++number };
    hideReadout();
    send();
  }

  // A picture with a tool is drawn on: a box, or a stroke of a brush.
  function strokePlace(image, event) {
    const { x_px, y_px } = placeOn(image, event);
    return [Math.round(x_px * 10) / 10, Math.round(y_px * 10) / 10];
  }

  function sendStroke() {
    const { image, tool, places, event } = held;
    const kept = tool === "box" ? [places[0], places.at(-1)] : places;
    act({
      kind: "stroke", picture: nameOf(image).dataset.picture, tool, places: kept,
      is_added: event.shiftKey,
    });
    held.places = [places.at(-1)];
  }

  function drawOn(event) {
    held.event = event;
    held.places.push(strokePlace(held.image, event));
    held.drawn.push(held.places.at(-1));
    if (held.tool === "brush" && held.places.length >= STROKE_PLACES) sendStroke();
    drawMarks(nameOf(held.image));
  }

  document.addEventListener("pointermove", (event) => {
    if (held) {
      moveReadout(event);
      const far = Math.hypot(event.clientX - held.x, event.clientY - held.y) > CLICK_PX;
      held.isDrag ||= far;
      if (held.isDrag && held.image.isConnected) {
        if (held.tool) drawOn(event);
        else point(held.image, "drag", event);
      }
      return;
    }
    const image = event.target instanceof HTMLImageElement ? event.target : null;
    if (image && nameOf(image)) {
      moveReadout(event);
      point(image, "move", event);
    } else {
      leave();
    }
  }, true);

  document.addEventListener("pointerdown", (event) => {
    const image = event.target;
    if (event.button !== 0 || !(image instanceof HTMLImageElement) || !nameOf(image)) return;
    const begin = strokePlace(image, event);
    held = {
      image, x: event.clientX, y: event.clientY, isDrag: false, event,
      tool: nameOf(image).dataset.tool, places: [begin], drawn: [begin],
    };
  }, true);

  document.addEventListener("pointerup", (event) => {
    if (!held) return;
    const { image, isDrag, tool } = held;
    if (image.isConnected && tool && (isDrag || tool === "brush")) {
      if (isDrag) held.places.push(strokePlace(image, event));
      held.event = event;
      sendStroke();
      held = null;
      drawMarks(nameOf(image));
      return;
    }
    held = null;
    if (!image.isConnected) return;
    if (isDrag) point(image, "drag", event);
    // The end of a drag too: the next place of the pointer must not take its place.
    const kind = isDrag ? "drag" : "click";
    act({ kind, picture: nameOf(image).dataset.picture, ...placeOn(image, event) });
  }, true);

  document.addEventListener("pointercancel", () => { held = null; }, true);
  // A drag of the browser's own would carry the picture away.
  document.addEventListener("dragstart", (event) => {
    if (event.target instanceof HTMLImageElement) event.preventDefault();
  }, true);
  document.documentElement.addEventListener("mouseleave", leave);

  const buttonAt = (target) => (target instanceof Element ? target.closest("[data-press]") : null);
  const isSame = (one, other) =>
    one.dataset.press === other.dataset.press && one.dataset.value === other.dataset.value;

  function press(button) {
    act({ kind: "press", name: button.dataset.press, value: button.dataset.value ?? "" });
    if (button.dataset.press === "link") copyLink(button);
  }

  // The server may send a button anew while the mouse is down on it: the browser sees no click then.
  let pressed = null;
  document.addEventListener("pointerdown", (event) => {
    pressed = event.button === 0 ? buttonAt(event.target) : null;
  }, true);
  document.addEventListener("pointerup", (event) => {
    const before = pressed;
    pressed = null;
    const button = buttonAt(document.elementFromPoint(event.clientX, event.clientY));
    if (before && button && button !== before && isSame(before, button)) press(button);
  }, true);
  document.addEventListener("click", (event) => {
    const button = buttonAt(event.target);
    if (button) press(button);
  }, true);

  async function copyLink(button) {
    const link = document.querySelector("[data-view-link]");
    if (!link) return;
    // In an inline handler plain "URL" is the document's own.
    const text = new window.URL(link.dataset.viewLink, location.href).href;
    try {
      await navigator.clipboard.writeText(text);
    } catch {
      // Without HTTPS browsers keep the clipboard from pages, but not from a selection.
      const field = document.createElement("textarea");
      field.value = text;
      document.body.append(field);
      field.select();
      document.execCommand("copy");
      field.remove();
    }
    const said = button.textContent;
    button.textContent = "Copied";
    setTimeout(() => { button.textContent = said; }, 1500);
  }

  // A button that has the focus takes Space and Enter: they are no keys of the page then.
  document.addEventListener("keydown", (event) => {
    if (buttonAt(event.target) && (event.key === " " || event.key === "Enter")) event.stopPropagation();
  }, true);

  // A button that the server sends anew keeps the focus that it had.
  let focused = null;
  document.addEventListener("focusin", (event) => {
    const button = buttonAt(event.target);
    focused = button && { dataset: { ...button.dataset } };
  });
  document.addEventListener("pointerdown", () => { focused = null; }, true);

  function restoreFocus() {
    if (!focused || document.activeElement !== document.body) return;
    for (const button of document.querySelectorAll("[data-press]")) {
      if (isSame(button, focused)) {
        button.focus({ preventScroll: true });
        return;
      }
    }
  }

  // viser's dialogues do not close on Escape, nor do its text fields give the keys back.
  document.addEventListener("keydown", (event) => {
    if (event.key !== "Escape") return;
    if (event.target instanceof HTMLInputElement) event.target.blur();
    const buttons = [...document.querySelectorAll('[role="dialog"] button')];
    buttons.find((button) => button.textContent.trim() === "Close")?.click();
  });

  // Marks over a picture, in its own pixels; they need no new picture.
  function drawMarks(name) {
    const outer = name.parentElement?.nextElementSibling;
    const image = outer?.querySelector("img");
    if (!image) return;
    const box = image.parentElement;
    let over = box.querySelector("svg.scanloom-marks");
    if (!over) {
      over = document.createElementNS(SVG, "svg");
      over.setAttribute("class", "scanloom-marks");
      over.setAttribute("preserveAspectRatio", "none");
      box.append(over);
    }
    over.setAttribute("viewBox", `-0.5 -0.5 ${name.dataset.width} ${name.dataset.height}`);
    over.replaceChildren(...JSON.parse(name.dataset.marks).flatMap(shapes), ...strokeShapes(name, image));
    if (pointer && pointer.kind !== "leave" && pointer.picture === name.dataset.picture) {
      showReadout(name.dataset.readout);
    }
  }

  function shapes({ kind, x_px, y_px, reach_px }) {
    const paths = {
      cross: `M${x_px - 9} ${y_px}h6m6 0h6M${x_px} ${y_px - 9}v6m0 6v6`,
      column: `M${x_px} ${y_px - reach_px}v${2 * reach_px}`,
      row: `M-10000 ${y_px}h20000`,
    };
    return ["dark", "light"].map((shade) => {
      const path = document.createElementNS(SVG, "path");
      path.setAttribute("d", paths[kind]);
      path.setAttribute("class", shade);
      return path;
    });
  }

  // What is being drawn with a tool.
  function strokeShapes(name, image) {
    if (!held || held.image !== image || !held.tool || !held.isDrag) return [];
    const path = document.createElementNS(SVG, "path");
    const [first, last] = [held.drawn[0], held.drawn.at(-1)];
    if (held.tool === "box") {
      path.setAttribute("d", `M${first}H${last[0]}V${last[1]}H${first[0]}Z`);
      path.setAttribute("class", "box");
    } else {
      path.setAttribute("d", `M${held.drawn.join("L")}`);
      path.setAttribute("class", "brush");
      path.setAttribute("stroke-width", 2 * Number(name.dataset.brushPx));
    }
    return [path];
  }

  // The legend, written by the server among the controls, stands over the scene.
  const legend = document.createElement("div");
  legend.setAttribute("role", "group");
  legend.setAttribute("aria-label", "Legend");
  document.body.append(legend);

  function showLegend(written) {
    const focused = legend.contains(document.activeElement) && document.activeElement.dataset.value;
    legend.className = `scanloom-over-scene ${written.classList.contains("dark") ? "dark" : ""}`;
    legend.innerHTML = written.innerHTML;
    // A pressed button keeps the focus, for the next press of its key.
    if (focused) {
      [...legend.children].find((button) => button.dataset.value === focused)?.focus();
    }
    placeLegend();
  }

  function placeLegend() {
    const canvas = document.querySelector("canvas[data-engine]");
    if (!canvas) return;
    const box = canvas.getBoundingClientRect();
    legend.style.left = `${box.left}px`;
    legend.style.top = `${box.top}px`;
    legend.style.maxWidth = `${box.width}px`;
  }

  const sized = new ResizeObserver(placeLegend);
  sized.observe(document.documentElement);
  const scene = setInterval(() => {
    const canvas = document.querySelector("canvas[data-engine]");
    if (!canvas) return;
    clearInterval(scene);
    sized.observe(canvas);
  }, 100);

  const readout = document.createElement("div");
  readout.className = "scanloom-readout";
  readout.hidden = true;
  document.body.append(readout);

  function showReadout(text) {
    readout.textContent = text;
    readout.hidden = !text;
  }

  function hideReadout() {
    readout.hidden = true;
  }

  function moveReadout(event) {
    const isRight = event.clientX > innerWidth / 2;
    const isLow = event.clientY > innerHeight / 2;
    readout.style.left = isRight ? "" : `${event.clientX + 16}px`;
    readout.style.right = isRight ? `${innerWidth - event.clientX + 16}px` : "";
    readout.style.top = isLow ? "" : `${event.clientY + 16}px`;
    readout.style.bottom = isLow ? `${innerHeight - event.clientY + 16}px` : "";
  }

  function take(added) {
    const written = added.matches(".scanloom-legend") ? added
      : added.querySelector(".scanloom-legend");
    if (written) showLegend(written);
    if (added.matches("[data-picture]")) drawMarks(added);
    for (const name of added.querySelectorAll("[data-picture]")) drawMarks(name);
    // The picture comes after its name.
    if (added.querySelector("img") && !added.classList.contains("scanloom-marks")) {
      const name = added.previousElementSibling?.querySelector("[data-picture]");
      if (name) drawMarks(name);
    }
  }

  new MutationObserver((changes) => {
    restoreFocus();
    for (const change of changes) {
      for (const added of change.addedNodes) if (added instanceof Element) take(added);
    }
  }).observe(document.body, { childList: true, subtree: true });
  // Some of it may have come before this script.
  take(document.body);

  const wish = matchMedia("(prefers-color-scheme: dark)");
  const screen = () => act({
    kind: "screen", width_px: innerWidth, height_px: innerHeight, prefers_dark: wish.matches,
  });
  wish.addEventListener("change", screen);
  let resized = 0;
  // Without its object it would be the image whose handler runs this script.
  window.addEventListener("resize", () => {
    clearTimeout(resized);
    resized = setTimeout(screen, 200);
  });
  screen();
})();
