// Plays one episode, or two on one time axis: moves frames, robots on maps, and cursors of plots together.
const player = document.getElementById("player");
const [last, hz] = [Number(player.dataset.last), Number(player.dataset.hz)]; // of the common time axis
const AHEAD = 12;
const MOST_LATE_MS = 250;
const episodes = [player, ...player.querySelectorAll("[data-here]")].filter((node) => node.dataset.here).map((node) => ({
  here: node.dataset.here,
  isRendered: Boolean(node.dataset.rendered),
  last: Number(node.dataset.last),
  hz: Number(node.dataset.hz),
  step: node.querySelector(".step"),
  robot: node.querySelector(".robot"),
  poses: node.querySelector(".robot").dataset.poses.split(" ").map((text) => text.split(",").map(Number)),
  images: [...node.querySelectorAll("img[data-kind]")],
}));
const frames = episodes.flatMap((episode) => episode.images.map((image) => ({ episode, image, kind: image.dataset.kind })));
const images = frames.map((frame) => frame.image);
const time = document.getElementById("time");
const play = document.getElementById("play");
const clock = document.getElementById("clock");
const [speed, loop, outlined] = ["speed", "loop", "outlined"].map((id) => document.getElementById(id));
const stride = () => Math.max(1, Math.ceil((hz * Number(speed.value)) / 30)); // at most 30 frames per second
const loaded = new Map();
let shown = Number(player.dataset.t);
let playing = false;
let turn = 0; // number of the newest playback
let pace = stride(); // steps from one shown frame to the next

// An episode that is shorter than the axis stays at its last step.
function stepOf(episode, t) {
  return Math.min(episode.last, Math.round((t * episode.hz) / hz));
}

// During playback, images are small, except stored colour frames, which the server sends without decoding them.
function source(t, { episode, kind }) {
  const isSmall = playing && (kind !== "rgb" || episode.isRendered);
  const step = stepOf(episode, t);
  return `${episode.here}${isSmall ? `playback/${step}` : `frames/${step}.png`}?kind=${kind}`;
}

function load(t) {
  if (!loaded.has(t)) {
    const parts = frames.map((frame) => Object.assign(new Image(), { src: source(t, frame) }));
    const ready = Promise.all(parts.map((part) => part.decode())).then(() => parts);
    ready.catch(() => {}); // `show` reports the error when the frame is due
    loaded.set(t, { parts, ready });
  }
  return loaded.get(t).ready;
}

function forget(t) {
  for (const part of loaded.get(t).parts) if (!part.complete) part.src = ""; // cancels the request
  loaded.delete(t);
}

function following(t) {
  return t < last ? Math.min(last, t + pace) : 0;
}

async function show(t) {
  shown = t;
  const wanted = [t];
  while (playing && wanted.length <= AHEAD && (wanted.at(-1) < last || loop.checked)) wanted.push(following(wanted.at(-1)));
  for (const known of [...loaded.keys()]) if (!wanted.includes(known)) forget(known);
  wanted.forEach(load);
  try {
    const parts = await load(t);
    if (shown !== t) return;
    parts.forEach((part, place) => {
      images[place].src = part.src;
      images[place].alt = `${frames[place].kind} at step ${stepOf(frames[place].episode, t)}`;
    });
    outline(parts);
  } catch {
    if (shown !== t) return;
    clock.value = `step ${t} cannot be shown`;
    return;
  }
  mark(t);
}

function mark(t) {
  for (const episode of episodes) {
    const at = stepOf(episode, t);
    const [x, y, turn] = episode.poses[at];
    episode.robot.setAttribute("transform", `translate(${x} ${y}) rotate(${turn})`);
    if (episode.step) episode.step.value = `step ${at} of ${episode.last}${t * episode.hz > episode.last * hz ? ", ended" : ""}`;
  }
  for (const chart of document.querySelectorAll("svg.chart[data-left]")) {
    const [left, right] = [Number(chart.dataset.left), Number(chart.dataset.right)];
    const cursor = chart.querySelector(".cursor");
    const at = left + ((right - left) * t) / Math.max(1, last);
    cursor.setAttribute("x1", at);
    cursor.setAttribute("x2", at);
  }
  const now = document.getElementById("now");
  if (now) for (const end of ["x1", "x2"]) now.setAttribute(end, (600 * t) / (last + 1));
  for (const step of document.querySelectorAll(".steps li")) {
    const holds = Number(step.dataset.first) <= t && t <= Number(step.dataset.last);
    holds ? step.setAttribute("aria-current", "step") : step.removeAttribute("aria-current");
  }
  time.value = t;
  clock.value = `step ${t} of ${last}, ${(t / hz).toFixed(2)} s`;
  player.dataset.t = t;
}

// Shows each frame at its time. A slow machine shows only every second, fourth or eighth frame and loads no others.
async function run() {
  const mine = ++turn;
  const goesOn = () => playing && turn === mine;
  let [due, early] = [performance.now(), 0];
  await show(shown);
  while (goesOn() && (shown < last || loop.checked)) {
    due += (1000 * pace) / hz / Number(speed.value);
    await show(following(shown));
    const late = performance.now() - due;
    early = late > 0 ? 0 : early + 1;
    if (late > MOST_LATE_MS) {
      pace = Math.min(8 * stride(), 2 * pace);
      due = performance.now();
    } else if (early > 30) {
      pace = Math.max(stride(), Math.ceil(pace / 2));
      early = 0;
    }
    while (goesOn() && performance.now() < due) await new Promise(requestAnimationFrame);
  }
  if (goesOn()) toggle();
}

function toggle() {
  playing = !playing;
  for (const known of [...loaded.keys()]) forget(known);
  play.textContent = playing ? "Pause" : "Play";
  play.setAttribute("aria-pressed", playing);
  if (playing) {
    if (shown >= last) shown = 0;
    run();
  } else {
    show(shown);
  }
}

play.addEventListener("click", toggle);
document.getElementById("step").addEventListener("click", () => show(Math.min(last, shown + 1)));
time.addEventListener("input", () => show(Number(time.value)));
for (const link of document.querySelectorAll(".steps a"))
  link.addEventListener("click", (event) => {
    event.preventDefault();
    show(Number(link.closest("li").dataset.first));
  });
document.getElementById("controls").hidden = false;
document.getElementById("steps").hidden = true;
mark(shown);

// The settings stay while the tab goes from episode to episode.
for (const control of [speed, loop, outlined].filter(Boolean)) {
  const name = control.type === "checkbox" ? "checked" : "value";
  const kept = sessionStorage.getItem(control.id);
  if (kept !== null) control[name] = name === "checked" ? kept === "true" : kept;
  control.addEventListener("change", () => sessionStorage.setItem(control.id, control[name]));
}
pace = stride();
speed.addEventListener("change", () => (pace = stride()));

// Draws the border of the target over the colour image; the target is red in the image of ids.
const border = document.getElementById("outline");

function outline(parts) {
  if (!outlined) return;
  border.hidden = !outlined.checked;
  const source = parts[images.findIndex((image) => image.dataset.kind === "ids")];
  const side = source.naturalWidth;
  if (border.hidden || !side) return;
  [border.width, border.height] = [side, side];
  const pen = border.getContext("2d", { willReadFrequently: true });
  pen.drawImage(source, 0, 0);
  const shown = pen.getImageData(0, 0, side, side);
  const colours = new Uint32Array(shown.data.buffer);
  const RED = new Uint32Array(new Uint8Array([255, 40, 40, 255]).buffer)[0];
  const WHITE = 0xffffffff;
  const reach = Math.max(1, Math.round(side / 320)); // width of the line, pixels of the image
  const isTarget = colours.map((colour) => Number(colour === RED));
  colours.fill(0);
  let found = 0;
  for (let at = 0; at < isTarget.length; at++) {
    if (!isTarget[at]) continue;
    found++;
    const x = at % side;
    const holds = (step) => (x < step || isTarget[at - step]) && (x + step >= side || isTarget[at + step]) && isTarget[at - step * side] !== 0 && isTarget[at + step * side] !== 0;
    if (!holds(reach)) colours[at] = RED;
    else if (!holds(2 * reach)) colours[at] = WHITE;
  }
  pen.putImageData(shown, 0, 0);
  border.dataset.target = found;
}
outlined?.addEventListener("change", () => show(shown));
if (outlined?.checked) show(shown);

const canvas = document.createElement("canvas");
const pen = canvas.getContext("2d", { willReadFrequently: true });
const ids = images.find((image) => image.dataset.kind === "ids");
let objects = null;

ids?.addEventListener("pointermove", async (event) => {
  objects ??= fetch(player.dataset.objects).then((reply) => reply.json());
  const names = await objects;
  const box = ids.getBoundingClientRect();
  canvas.width = ids.naturalWidth;
  canvas.height = ids.naturalHeight;
  pen.drawImage(ids, 0, 0);
  const x = Math.floor(((event.clientX - box.left) / box.width) * canvas.width);
  const y = Math.floor(((event.clientY - box.top) / box.height) * canvas.height);
  const key = [...pen.getImageData(x, y, 1, 1).data.slice(0, 3)].join(",");
  document.getElementById("object").textContent = key === "0,0,0" ? ": nothing" : `: ${names[key] ?? "unknown"}`;
});
ids?.addEventListener("pointerleave", () => {
  document.getElementById("object").textContent = "";
});
