// Replaces the content of #live with the fragments that the server sends, while the tab is visible.
const part = document.getElementById("live");
const offline = document.getElementById("offline");
let source = null;

function listen() {
  if (document.hidden) {
    source?.close();
    source = null;
  } else if (!source) {
    source = new EventSource(part.dataset.events);
    source.onopen = () => (offline.hidden = true);
    source.onerror = () => (offline.hidden = false);
    source.onmessage = (event) => {
      const focused = document.activeElement?.closest("#live") ? document.activeElement.getAttribute("aria-label") : null;
      part.innerHTML = event.data;
      if (focused) part.querySelector(`[aria-label="${CSS.escape(focused)}"]`)?.focus({ preventScroll: true });
    };
  }
}

document.addEventListener("visibilitychange", listen);
addEventListener("pagehide", () => source?.close());
listen();
