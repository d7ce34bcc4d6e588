// Mouse, touch and arrow keys on the canvas, as movements of the camera.

const RADIANS_PER_PIXEL = 0.008;
const KEY_STEP = 0.12;
const ARROWS = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, 1], ArrowDown: [0, -1] };

/// Calls `moved` after each movement.
export function listen(canvas, camera, moved) {
  const pointers = new Map();

  const spread = () => {
    const [a, b] = [...pointers.values()];
    return { x: (a.x + b.x) / 2, y: (a.y + b.y) / 2, size: Math.hypot(a.x - b.x, a.y - b.y) };
  };
  const pan = (x, y) => camera.pan(x / canvas.clientHeight, -y / canvas.clientHeight);

  canvas.addEventListener("pointerdown", event => {
    if (pointers.size === 2) return;
    canvas.setPointerCapture(event.pointerId);
    const panning = event.button !== 0 || event.shiftKey;
    pointers.set(event.pointerId, { x: event.clientX, y: event.clientY, panning });
  });

  canvas.addEventListener("pointermove", event => {
    const pointer = pointers.get(event.pointerId);
    if (!pointer) return;
    const [x, y] = [event.clientX - pointer.x, event.clientY - pointer.y];
    const before = pointers.size === 2 && spread();
    Object.assign(pointer, { x: event.clientX, y: event.clientY });
    if (before) {
      const after = spread();
      if (after.size > 0) camera.zoom(before.size / after.size);
      pan(after.x - before.x, after.y - before.y);
    } else if (pointer.panning) {
      pan(x, y);
    } else {
      camera.orbit(-x * RADIANS_PER_PIXEL, y * RADIANS_PER_PIXEL);
    }
    moved();
  });

  for (const end of ["pointerup", "pointercancel"]) {
    canvas.addEventListener(end, event => pointers.delete(event.pointerId));
  }

  canvas.addEventListener("contextmenu", event => event.preventDefault());

  canvas.addEventListener("wheel", event => {
    event.preventDefault();
    const pixels = event.deltaY * (event.deltaMode === WheelEvent.DOM_DELTA_LINE ? 20 : 1);
    // Pinching on a touchpad arrives as small steps with Ctrl.
    camera.zoom(Math.exp(pixels * (event.ctrlKey ? 0.01 : 0.0012)));
    moved();
  }, { passive: false });

  canvas.addEventListener("keydown", event => {
    if (event.ctrlKey || event.metaKey || event.altKey) return;
    const arrow = ARROWS[event.key];
    if (arrow && event.shiftKey) camera.pan(arrow[0] * 0.05, arrow[1] * 0.05);
    else if (arrow) camera.orbit(arrow[0] * KEY_STEP, arrow[1] * KEY_STEP);
    else if (event.key === "+" || event.key === "=") camera.zoom(1 / 1.1);
    else if (event.key === "-") camera.zoom(1.1);
    else return;
    event.preventDefault();
    moved();
  });
}
