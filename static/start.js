// Runs before viser's own script, and so before its first picture.
(() => {
  // viser eases its docks into place, and each step draws the whole scene anew. It does not beneath
  // an element with this attribute, which it sets itself while a dock is being resized.
  document.documentElement.setAttribute("data-dock-resizing", "");

  // Until it hears that nothing lights the scene from around, viser decodes a photograph for it.
  // Nothing else is fetched from such an address.
  const fetch = window.fetch.bind(window);
  window.fetch = (resource, options) => {
    const address = resource instanceof Request ? resource.url : String(resource);
    return address.startsWith("data:image/jpeg;") ? new Promise(() => {}) : fetch(resource, options);
  };

  // The style of this page puts the scene where the docks will leave it room: it would be drawn over
  // the whole window first. It ends once the session shows something, for people move docks.
  new MutationObserver((_, observer) => {
    if (!document.querySelector(".scanloom-verdict")) return;
    observer.disconnect();
    requestAnimationFrame(() => document.querySelector("style[data-before-docks]").remove());
  }).observe(document, { childList: true, subtree: true });
})();
