// The guide's page: sends the phone's pose, speaks and shows what the guide says, and stops the person by itself when
// nothing comes any more.
"use strict";

const SILENCE = 400; // [ms] Without a cue for so long the person is stopped; a cue comes every 100 ms.
const STOP_AGAIN = 8000; // [ms]
const ANSWERS = 3000; // [ms] A connection that has brought nothing by then is made anew.
const CALL_AGAIN = 500; // [ms] After one that was refused.
const FEEL = { stop: [500, 100, 500], arrived: [200, 100, 200, 100, 200], slow: [60], go: [30] };
const STEP = 1.2; // [m/s²] A foot that is set down shakes the phone by this.
const STEP_PAUSE = 300; // [ms] No two steps are nearer.

const byId = (id) => document.getElementById(id);
const texts = JSON.parse(byId("texts").textContent); // What the page shows and says by itself, in the guide's language.
const language = document.documentElement.lang;
const token = new URLSearchParams(location.search).get("token") || "";
let socket = null;
let led = false; // Whether cues have come: only who is led can be stopped.
let lastCue = 0, alone = false, action = "", deadline = 0, again = 0;
let answered = null; // The pose that the last cue was made of.
let speaking = -1, steps = 0, lastStep = 0, counts = false;
window.gpdf = { said: [], cues: 0, late: 0, latency: [], alone: [] }; // What happened, for a look into it.

const clock = () => (performance.timeOrigin + performance.now()) / 1000; // [s] Of the poses, and of what comes back.

function state(text, cue) {
  const box = byId("state");
  if (box.textContent !== text) box.textContent = text;
  box.dataset.cue = cue || "";
}

function speak(text, urgency) {
  byId("words").textContent = text;
  window.gpdf.said.push({ text, time: performance.now() });
  if (byId("reader").checked || !("speechSynthesis" in window)) return;
  if (urgency > speaking || urgency === 3) speechSynthesis.cancel();
  const words = new SpeechSynthesisUtterance(text);
  words.lang = language;
  words.onend = () => { speaking = -1; };
  speaking = urgency;
  speechSynthesis.speak(words);
}

function feel(pattern) {
  if (navigator.vibrate) navigator.vibrate(pattern);
}

function cue(message) {
  if (message.sent !== null && 1000 * (clock() - message.sent) > SILENCE) {
    window.gpdf.late += 1; // a network that comes back brings what was true before
    return;
  }
  lastCue = performance.now();
  led = true;
  window.gpdf.cues += 1;
  if (message.pose !== answered) window.gpdf.latency.push(1000 * (clock() - message.pose)); // the first cue after a pose
  answered = message.pose;
  clearTimeout(deadline);
  if (message.action !== "arrived") deadline = setTimeout(silent, SILENCE);
  if (alone) { alone = false; feel(0); }
  const side = message.direction > 0 ? "left" : "right";
  const degrees = Math.round(Math.abs(message.direction) * 180 / Math.PI / 5) * 5;
  const turn = side === "left" ? texts.turn_left : texts.turn_right;
  state(message.action === "turn" ? turn.replace("{degrees}", degrees) : texts[message.action], message.action);
  const felt = message.action === "turn" ? (side === "left" ? [80] : [80, 80, 80]) : FEEL[message.action];
  const key = message.action + (message.action === "turn" ? side : "");
  if (key !== action) feel(felt);
  action = key;
}

function silent() { // The page's own stop: it needs nobody.
  if (!alone) window.gpdf.alone.push(performance.now() - lastCue);
  alone = true;
  action = "";
  deadline = setTimeout(silent, STOP_AGAIN);
  state(texts.alone, "stop");
  feel(FEEL.stop);
  speak(texts.stop_alone, 3);
  connect();
}

function options(select, names, chosen) { // What was chosen before stays.
  const kept = select.value || chosen;
  const none = new Option(texts.choose, "");
  select.replaceChildren(none, ...names.map((name) => new Option(name, name, false, name === kept)));
  select.value = names.includes(kept) ? kept : "";
}

function take(message) {
  if (message.type === "cue") return cue(message);
  if (message.type === "say") {
    if (message.until !== null && clock() > message.until) return undefined;
    byId("question").hidden = message.answers.length === 0;
    speak(message.text, message.urgency);
    if (message.answers.length) document.querySelector('[data-ask="yes"]').focus();
    return undefined;
  }
  if (message.type === "hello") {
    for (const id of ["place", "facing", "goal"]) options(byId(id), message.places, id === "goal" ? message.goal : "");
    if (!led) state(texts.connected);
    if (!window.gpdf.said.length) byId("words").textContent = texts.first;
    return undefined;
  }
  if (message.type === "here") {
    speak(message.fine ? texts.thanks : texts.unknown, 2);
    byId("here").hidden = !message.fine && byId("here").hidden;
    return undefined;
  }
  if (message.type === "drift") {
    byId("drift").textContent = texts.drift.replace("{centimetres}", Math.round(100 * message.accuracy));
  }
  return undefined;
}

function connect() { // A socket whose network has gone never says so: it is left, and what it still holds is not heard.
  if (socket) {
    socket.onmessage = socket.onclose = null;
    socket.close();
  }
  socket = new WebSocket(`wss://${location.host}/socket?token=${encodeURIComponent(token)}`);
  socket.onmessage = (event) => { clearTimeout(again); take(JSON.parse(event.data)); };
  socket.onclose = () => { clearTimeout(again); again = setTimeout(connect, CALL_AGAIN); };
  clearTimeout(again);
  again = setTimeout(connect, ANSWERS);
}

function send(message) {
  if (socket && socket.readyState === WebSocket.OPEN && socket.bufferedAmount < 4096) {
    socket.send(JSON.stringify(message));
    return true;
  }
  return false;
}

function ask(what, goal) {
  if (["yes", "no"].includes(what)) byId("question").hidden = true;
  if (!send({ type: "ask", ask: what, goal, id: `${what}-${Math.round(performance.now())}` })) {
    speak(texts.stop_alone, 3);
  }
}

const Recognition = window.SpeechRecognition || window.webkitSpeechRecognition;
const bare = (text) => text.toLowerCase().replace(/[^\p{L} ]/gu, "").trim();

function listen() { // What stands on a button may be spoken, that and no more: "yes or no" of a question is no "yes".
  const ear = new Recognition();
  const before = window.gpdf.said.length;
  if ("speechSynthesis" in window) speechSynthesis.cancel();
  ear.lang = language;
  ear.maxAlternatives = 3;
  ear.onerror = () => speak(texts.not_heard, 2);
  ear.onresult = (event) => {
    const spoken = [...event.results[0]].map((one) => bare(one.transcript));
    const buttons = [...document.querySelectorAll("[data-ask]")].filter((one) => one.offsetParent !== null);
    const meant = buttons.find((one) => spoken.includes(bare(one.textContent)));
    if (!meant || window.gpdf.said.length > before) return speak(texts.not_heard, 2); // it may have heard itself
    return ask(meant.dataset.ask);
  };
  ear.start();
}

let sent = 0;
function frame(time, xr, space) {
  const pose = xr.getViewerPose(space);
  if (!pose || time - sent < 45) return;
  sent = time;
  const { position: p, orientation: q } = pose.transform;
  const message = { type: "pose", position: [p.x, p.y, p.z], orientation: [q.x, q.y, q.z, q.w] };
  message.time = clock();
  message.tracked = !pose.emulatedPosition;
  if (counts) message.steps = steps;
  send(message);
}

async function track() { // The phone's own tracking: immersive-ar, so that the camera is on; nothing is drawn.
  const options_ = { requiredFeatures: ["local-floor"], optionalFeatures: ["dom-overlay"], domOverlay: { root: document.body } };
  const session = await navigator.xr.requestSession("immersive-ar", options_);
  const gl = byId("xr").getContext("webgl", { xrCompatible: true });
  await session.updateRenderState({ baseLayer: new XRWebGLLayer(session, gl) });
  const space = await session.requestReferenceSpace("local-floor");
  await new Promise((first) => {
    const loop = (time, xr) => { session.requestAnimationFrame(loop); frame(time, xr, space); first(); };
    session.requestAnimationFrame(loop);
  });
  session.addEventListener("end", () => {
    byId("start").hidden = false;
    feel(FEEL.stop);
    state(texts.track_end, "stop");
    speak(texts.track_end_help, 3);
  });
}

function shaken(event) { // Steps, from how the phone shakes.
  const a = event.acceleration;
  const now = performance.now();
  if (!a || a.y === null) return;
  counts = true;
  if (Math.hypot(a.x, a.y, a.z) > STEP && now - lastStep > STEP_PAUSE) { steps += 1; lastStep = now; }
}

async function start() {
  const here = { type: "here", place: byId("place").value, facing: byId("facing").value };
  if (!here.place || !here.facing || here.place === here.facing) return speak(texts.two_places, 2);
  if (!navigator.xr || !(await navigator.xr.isSessionSupported("immersive-ar").catch(() => false))) {
    state(texts.no_tracking, "");
    return speak(texts.no_tracking_help, 2);
  }
  try {
    await track();
  } catch (error) {
    state(texts.not_tracked, "stop");
    return speak(texts.not_tracked_help, 2);
  }
  addEventListener("devicemotion", shaken);
  setTimeout(() => send(here), 200); // a pose goes ahead of it
  byId("start").hidden = true;
  byId("here").hidden = false;
  return undefined;
}

byId("start").addEventListener("click", start);
byId("here").addEventListener("click", () => send({ type: "here", place: byId("place").value, facing: null }));
byId("go").addEventListener("click", () => ask("goal", byId("goal").value));
byId("listen").hidden = !Recognition;
byId("listen").addEventListener("click", listen);
byId("reader").addEventListener("change", (event) => { byId("words").setAttribute("aria-live", event.target.checked ? "assertive" : "off"); });
for (const button of document.querySelectorAll("[data-ask]")) button.addEventListener("click", () => ask(button.dataset.ask));
connect();
