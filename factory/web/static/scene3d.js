// Shows a scene in 3D with the trajectory and the robot of an episode. Draws a picture only when something has changed.
import { Box3, BoxGeometry, CatmullRomCurve3, DirectionalLight, Group, HemisphereLight, Mesh, MeshBasicMaterial, MeshLambertMaterial, PerspectiveCamera, Plane, Scene, TubeGeometry, Vector3, WebGLRenderer } from "./vendor/three.module.min.js";
import { readGlb } from "./glb.js";

const canvas = document.getElementById("scene3d");
const message = document.getElementById("message");
const [time, play, clock] = ["time", "play", "clock"].map((id) => document.getElementById(id));
const poses = (canvas.dataset.poses ?? "").split(" ").filter(Boolean).map((text) => text.split(",").map(Number));
const [hz, floor] = [Number(canvas.dataset.hz), Number(canvas.dataset.floor)];
const LIFT_M = 0.06;
const SPACING_M = 0.05;
const UNDER_CEILING_M = 0.4;
const style = getComputedStyle(document.documentElement);
const colour = (name) => style.getPropertyValue(`--${name}`).trim();
const cut = document.getElementById("cut");
const ceiling = new Plane(new Vector3(0, -1, 0), 0);
const target = new Vector3();
const orbit = { turn: 0.8, tilt: 0.9, distance: 10 };
// what is between camera and robot: behind a plane at the robot, and above the floor
const inFront = [new Plane(), new Plane(new Vector3(0, -1, 0), floor + 0.01)];
const CORNERS_M = [[0.2, 0.25], [0.2, -0.25], [-0.61, 0.25], [-0.61, -0.25]]; // of the robot: x forward, y left
const BEHIND = { turn: -Math.PI / 2, tilt: 0.5, distance: 4.5 }; // turn from the heading of the robot
const [follow, clear] = ["follow", "clear"].map((id) => document.getElementById(id));
const materials = new Set(); // of the scene, without the robot
let renderer, camera, scene, robot, playing = false, step = 0, isWaiting = false;

// the page has x forward, y left, z up; glTF has x right, y up, z backward
const point = ([x, y]) => new Vector3(x, floor + LIFT_M, -y);

function draw() {
  if (isWaiting) return;
  isWaiting = true;
  requestAnimationFrame(() => {
    isWaiting = false;
    const [width, height] = [canvas.clientWidth, canvas.clientHeight];
    renderer.setSize(width, height, false);
    camera.aspect = width / height;
    camera.updateProjectionMatrix();
    const flat = orbit.distance * Math.cos(orbit.tilt);
    const offset = new Vector3(flat * Math.sin(orbit.turn), orbit.distance * Math.sin(orbit.tilt), flat * Math.cos(orbit.turn));
    camera.position.copy(target).add(offset);
    camera.lookAt(target);
    if (robot) cutInFront();
    renderer.render(scene, camera);
    canvas.dataset.step = step;
    canvas.dataset.drawn = Number(canvas.dataset.drawn ?? 0) + 1;
  });
}

// Hides the parts of the scene that are nearer to the camera than the whole robot, but not the floor.
function cutInFront() {
  const away = new Vector3(robot.position.x - camera.position.x, 0, robot.position.z - camera.position.z).normalize();
  const corners = CORNERS_M.map(([x, y]) => new Vector3(x, 0, -y).applyAxisAngle(new Vector3(0, 1, 0), robot.rotation.y).add(robot.position));
  const nearest = corners.reduce((one, other) => (away.dot(other) < away.dot(one) ? other : one));
  inFront[0].setFromNormalAndCoplanarPoint(away, nearest);
  canvas.dataset.cut = clear.checked ? `${away.x.toFixed(3)},${(-away.z).toFixed(3)}` : "";
}

function setClear() {
  for (const material of materials) material.clippingPlanes = clear.checked ? inFront : null;
  for (const material of materials) material.needsUpdate = true;
  draw();
}

function turn(dx, dy) {
  orbit.turn -= dx;
  orbit.tilt = Math.min(1.55, Math.max(0.05, orbit.tilt + dy));
  draw();
}

function zoom(factor) {
  orbit.distance = Math.min(200, Math.max(0.5, orbit.distance * factor));
  draw();
}

function place(t) {
  const [x, y, yaw] = poses[t];
  if (follow.checked) {
    target.add(point([x, y])).sub(point(poses[step]));
    orbit.turn += yaw - poses[step][2];
  }
  step = t;
  robot.position.copy(point([x, y]));
  robot.rotation.y = yaw;
  time.value = t;
  clock.value = `step ${t} of ${poses.length - 1}, ${(t / hz).toFixed(2)} s`;
  draw();
}

function addEpisode() {
  const points = [];
  for (const at of poses.map(point)) if (!points.length || at.distanceTo(points.at(-1)) > SPACING_M) points.push(at);
  if (points.length > 1) {
    const tube = new TubeGeometry(new CatmullRomCurve3(points), 4 * points.length, 0.03, 6);
    scene.add(new Mesh(tube, new MeshBasicMaterial({ color: colour("scene1"), depthTest: false, transparent: true })));
  }
  robot = new Group();
  const body = new Mesh(new BoxGeometry(0.75, 0.5, 0.5), new MeshLambertMaterial({ color: colour("object") }));
  const front = new Mesh(new BoxGeometry(0.1, 0.12, 0.3), new MeshLambertMaterial({ color: colour("card") }));
  body.position.set(-0.23, 0.25, 0);
  front.position.set(0.14, 0.4, 0);
  robot.add(body, front);
  scene.add(robot);
  const [x, y, yaw] = poses[0];
  target.copy(point([x, y]));
  target.y += 0.4;
  Object.assign(orbit, { ...BEHIND, turn: BEHIND.turn + yaw });
  for (const material of materials) material.clipIntersection = true;
  renderer.localClippingEnabled = true;
  setClear();
}

function run(begin, first) {
  if (!playing) return;
  const t = Math.min(poses.length - 1, first + Math.floor(((performance.now() - begin) / 1000) * hz));
  place(t);
  if (t === poses.length - 1) return toggle();
  requestAnimationFrame(() => run(begin, first));
}

function toggle() {
  playing = !playing;
  play.textContent = playing ? "Pause" : "Play";
  play.setAttribute("aria-pressed", playing);
  if (playing) run(performance.now(), step >= poses.length - 1 ? 0 : step);
}

function listen() {
  const down = new Map();
  canvas.addEventListener("pointerdown", (event) => {
    canvas.setPointerCapture(event.pointerId);
    down.set(event.pointerId, [event.clientX, event.clientY]);
  });
  canvas.addEventListener("pointermove", (event) => {
    const last = down.get(event.pointerId);
    if (!last) return;
    turn((event.clientX - last[0]) / 150, (event.clientY - last[1]) / 150);
    down.set(event.pointerId, [event.clientX, event.clientY]);
  });
  for (const end of ["pointerup", "pointercancel"]) canvas.addEventListener(end, (event) => down.delete(event.pointerId));
  canvas.addEventListener("wheel", (event) => {
    event.preventDefault();
    zoom(Math.exp(event.deltaY / 800));
  });
  const keys = {
    ArrowLeft: () => turn(0.1, 0), ArrowRight: () => turn(-0.1, 0), ArrowUp: () => turn(0, 0.1), ArrowDown: () => turn(0, -0.1),
    "+": () => zoom(0.85), "-": () => zoom(1.18),
  };
  canvas.addEventListener("keydown", (event) => {
    if (!(event.key in keys)) return;
    event.preventDefault();
    keys[event.key]();
  });
  cut.addEventListener("input", () => {
    ceiling.constant = floor + Number(cut.value);
    draw();
  });
  new ResizeObserver(draw).observe(canvas);
  if (!poses.length) return;
  play.addEventListener("click", toggle);
  time.addEventListener("input", () => place(Number(time.value)));
  clear.addEventListener("change", setClear);
  for (const part of document.querySelectorAll(".player")) part.hidden = false;
}

async function start() {
  try {
    renderer = new WebGLRenderer({ canvas, antialias: true, alpha: true, powerPreference: "low-power" });
  } catch {
    message.textContent = "This browser does not provide WebGL, which the 3D view needs. The map shows the same scene.";
    return;
  }
  message.textContent = "The scene is being loaded.";
  try {
    scene = new Scene();
    camera = new PerspectiveCamera(50, 1, 0.05, 500);
    const mesh = await readGlb(canvas.dataset.scene);
    mesh.traverse((part) => part.material && materials.add(part.material));
    const sun = new DirectionalLight(0xffffff, 1.2);
    sun.position.set(0.4, 1, 0.7);
    scene.add(mesh, new HemisphereLight(0xffffff, 0xb0b0b0, 2.2), sun);
    const box = new Box3().setFromObject(mesh);
    box.getCenter(target);
    orbit.distance = 0.8 * box.getSize(new Vector3()).length();
    cut.max = (box.max.y - floor).toFixed(2);
    cut.value = Math.max(0.5, box.max.y - floor - UNDER_CEILING_M);
    ceiling.constant = floor + Number(cut.value);
    renderer.clippingPlanes = [ceiling];
    if (poses.length) addEpisode();
    listen();
    canvas.hidden = document.getElementById("cutting").hidden = false;
    if (poses.length) place(0);
    draw();
    message.textContent = "Drag or use the arrow keys to turn the view; use the wheel, + or - to zoom.";
  } catch (error) {
    message.textContent = `The scene cannot be shown: ${error.message}`;
  }
}

start();
