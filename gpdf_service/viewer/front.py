"""The first file that a browser gets: viser's, with our title and icon, room on a phone, and names for a screen reader.

viser has no hook for any of these. What it draws later is named as it comes. And of what is typed and pressed within
`THROTTLE_MS` viser sends the first and the last alone, whichever fields these are of: here all of it is sent. One entry
of the browser's storage is the end of the address (`sharing`). Lines of `THROUGH_WIDTH` are drawn before all else,
every second pixel of them: a way shows, faded, through the floor over it. Where three.js's line shader is another one,
that is left out, and nothing else.
"""

from __future__ import annotations

from pathlib import Path

from gpdf_service.viewer.panel import SHARE
from gpdf_service.viewer.path_layers import THROUGH_WIDTH
from gpdf_service.viewer.sharing import KEY

TITLE = "<title>Viser</title>"
"""viser's; where it is missing, the page is left as it is."""
THROTTLE_MS = 50
"""[ms] viser's. It is longer while the browser draws, since the timer waits for that."""
HEAD = """<title>Plan a way · gpdf</title>
<link rel="icon" href="data:image/svg+xml,%3Csvg xmlns='http://www.w3.org/2000/svg' viewBox='0 0 16 16'%3E%3Cpath
 d='M3 13C3 6 13 11 13 4' fill='none' stroke='%230072b2' stroke-width='2'/%3E%3Ccircle cx='3' cy='13' r='2.4'
 fill='%23009e73'/%3E%3Ccircle cx='13' cy='3.4' r='2.4' fill='%23cc79a7'/%3E%3C/svg%3E">
<style>
:root { --mantine-color-gray-filled: #5c636a !important; }
.mantine-Button-root[data-variant=outline] { color: #005a8f !important; border-color: #005a8f !important; }
.mantine-Button-root[style*="gray"] { background: #5c636a !important; }
label { color: #343a40 !important; }
[role=alert], [role=status] { scroll-margin: 1em 0 5em; }
[data-dock-minimize] { min-width: 24px; min-height: 24px; }
@media (max-width: 36em) {
  [style*="width: 20em"] { width: 100% !important; }
  [style*="max-height: 60%"] { max-height: 45% !important; }
}
</style>
<script>
"use strict";
const later = window.setTimeout;
let atOnce = true;  // what an early timer sets itself comes in time: it may set itself for ever
window.setTimeout = (act, ms, ...rest) => {
  if (ms !== THROTTLE_MS || typeof act !== "function" || !atOnce) return later(act, ms, ...rest);
  queueMicrotask(() => { atOnce = false; try { act(...rest); } finally { atOnce = true; } });
  return 0;
};
const LINK = "viser-user:KEY";  // as viser names it
let link = location.hash.slice(1);
if (link) history.replaceState(null, "", location.pathname);  // viser would ask for it as a part of its own address
const { getItem, setItem } = Storage.prototype;
Storage.prototype.getItem = function (key) { return key === LINK ? link : getItem.call(this, key); };
Storage.prototype.setItem = function (key, value) {
  if (key !== LINK) return setItem.call(this, key, value);
  link = value;
  history.replaceState(null, "", `#${link}`);
};
window.addEventListener("hashchange", () => location.reload());  // somebody put another link there
document.addEventListener("click", async event => {
  if (event.target.closest("button")?.textContent.trim() !== "SHARE") return;
  try { await navigator.clipboard.writeText(location.href); }
  catch { window.prompt("SHARE", location.href); }  // without TLS a browser lets nobody copy for one
});
const { shaderSource } = WebGL2RenderingContext.prototype;
WebGL2RenderingContext.prototype.shaderSource = function (shader, source) {
  if (source.includes("uniform float linewidth;")) source = source
    .replace("gl_Position = clip;", `gl_Position = clip;  // the nearest depth is 1 where depth is reversed, else -1
      if (linewidth == WIDTH) gl_Position.z = (projectionMatrix[2][2] > 0.0 ? 0.999 : -0.999) * clip.w;`)
    .replace("gl_FragColor = ", `vec2 px = floor(gl_FragCoord.xy);
      if (linewidth == WIDTH && mod(px.x + px.y, 2.0) > 0.5) discard;
      gl_FragColor = `);
  return shaderSource.call(this, shader, source);
};
const NAMES = [["canvas", "Map of the scene. Start and goal can be typed, too."]];
function nameAll() {
  for (const [what, name] of NAMES) {
    for (const one of document.querySelectorAll(`${what}:not([aria-label])`)) {
      one.setAttribute("role", "img");
      one.setAttribute("aria-label", name);
    }
  }
  for (const label of document.querySelectorAll("label[for]")) {  // viser's labels name no field
    let row = label;
    while (row && !row.querySelector("input, [role=slider]")) row = row.parentElement;
    for (const field of row ? row.querySelectorAll("input, [role=slider]") : []) {
      if (!field.labels || field.labels.length === 0) field.setAttribute("aria-label", label.textContent.trim());
    }
  }
  for (const card of document.querySelectorAll("[role=alert]:not([data-met]), [role=status]:not([data-met])")) {
    card.dataset.met = "";  // on a phone it is below the fold
    card.scrollIntoView({ block: "nearest" });
  }
  for (const button of document.querySelectorAll("button:not([aria-label])")) {
    if (!button.textContent.trim()) button.setAttribute("aria-label", "Settings of the picture");
  }
}
document.addEventListener("DOMContentLoaded", () => {
  let due = 0;
  const soon = () => { cancelAnimationFrame(due); due = requestAnimationFrame(nameAll); };
  new MutationObserver(soon).observe(document.body, { childList: true, subtree: true });
});
</script>"""


def front_page() -> bytes:
    """Viser's page with what it has no hook for."""
    import viser

    page = Path(viser.__file__).parent / "client" / "build" / "index.html"
    head = HEAD.replace("WIDTH", f"{THROUGH_WIDTH:.1f}")
    head = head.replace("THROTTLE_MS", str(THROTTLE_MS)).replace("KEY", KEY).replace("SHARE", SHARE)
    return page.read_text(encoding="utf-8").replace(TITLE, head, 1).encode()
