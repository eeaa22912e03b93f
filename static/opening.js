// The opening dialog's part of the page: files that are dropped or chosen go to the server through a
// socket of their own.
(() => {
  if (window.scanloomOpening) return;
  window.scanloomOpening = true;

  const PART_BYTES = 128 * 1024;
  const AHEAD_BYTES = 8 * PART_BYTES;

  // As a button of the server's that is pressed.
  function press(name, value = "") {
    const button = document.createElement("button");
    button.hidden = true;
    button.dataset.press = name;
    button.dataset.value = value;
    document.body.append(button);
    button.click();
    button.remove();
  }

  function connected(ticket) {
    const scheme = location.protocol === "https:" ? "wss" : "ws";
    const socket = new WebSocket(`${scheme}://${location.host}/upload?ticket=${ticket}`);
    return new Promise((resolve, reject) => {
      socket.onopen = () => resolve(socket);
      socket.onerror = reject;
    });
  }

  // Once connected, the server says what is wrong; here it only ends.
  async function upload(file) {
    const place = document.querySelector("[data-upload]");
    if (!place) return;
    let socket;
    try {
      socket = await connected(place.dataset.upload);
    } catch {
      press("upload-refused", "unconnected");
      return;
    }
    try {
      const allowed = new Promise((resolve) => {
        socket.onmessage = () => resolve(true);
        socket.onclose = () => resolve(false);
      });
      socket.send(JSON.stringify({ name: file.name.slice(0, 4096), size: file.size }));
      if (!(await allowed)) return;
      const isOpen = () => socket.readyState === WebSocket.OPEN;
      for (let at = 0; at < file.size && isOpen(); at += PART_BYTES) {
        socket.send(await file.slice(at, at + PART_BYTES).arrayBuffer());
        while (socket.bufferedAmount > AHEAD_BYTES && isOpen()) {
          await new Promise((resolve) => setTimeout(resolve, 10));
        }
      }
    } catch {
      socket.close();
    }
  }

  const hasFiles = (event) => event.dataTransfer?.types.includes("Files");
  const mark = (isOver) => document.body.classList.toggle("scanloom-drop", isOver);

  document.addEventListener("dragover", (event) => {
    if (!hasFiles(event) || !document.querySelector("[data-upload]")) return;
    event.preventDefault();
    mark(true);
  }, true);
  document.addEventListener("dragleave", (event) => {
    if (!event.relatedTarget) mark(false);
  }, true);
  document.addEventListener("drop", (event) => {
    if (!hasFiles(event)) return;
    event.preventDefault();
    mark(false);
    const items = [...event.dataTransfer.items];
    const isFolder = items.some((item) => item.webkitGetAsEntry?.()?.isDirectory);
    if (isFolder || items.length > 1) press("upload-refused", isFolder ? "folder" : "several");
    else upload(event.dataTransfer.files[0]);
  }, true);

  document.addEventListener("change", (event) => {
    const field = event.target;
    if (!(field instanceof HTMLInputElement) || field.dataset.uploadFile === undefined) return;
    if (field.files.length === 1) upload(field.files[0]);
    field.value = "";
  }, true);
})();
