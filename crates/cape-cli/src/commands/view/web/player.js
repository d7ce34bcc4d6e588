// Frames in time.

export class Player {
  count = 0;
  fps = 30;
  position = 0;
  playing = false;
  loop = true;
  #show;
  #changed;
  #begin = 0;

  /// `show(frame)` is called for each frame to be seen, `changed` when it starts or stops.
  constructor(show, changed) {
    this.#show = show;
    this.#changed = changed;
  }

  load(count, fps) {
    Object.assign(this, { count, fps, position: 0 });
    this.#begin = performance.now();
  }

  toggle() {
    if (this.playing) this.pause();
    else this.play();
  }

  play() {
    if (this.playing || this.count < 2) return;
    if (this.position === this.count - 1) this.position = 0;
    this.playing = true;
    this.#begin = performance.now() - (1000 * this.position) / this.fps;
    this.#changed();
    requestAnimationFrame(() => this.#tick());
  }

  pause() {
    if (!this.playing) return;
    this.playing = false;
    this.#changed();
  }

  seek(frame) {
    this.position = frame;
    this.#begin = performance.now() - (1000 * frame) / this.fps;
    this.#show(frame);
  }

  #tick() {
    if (!this.playing) return;
    const elapsed = Math.floor(((performance.now() - this.#begin) * this.fps) / 1000);
    const frame = this.loop ? elapsed % this.count : Math.min(elapsed, this.count - 1);
    if (frame !== this.position) {
      this.position = frame;
      this.#show(frame);
    }
    if (!this.loop && elapsed >= this.count) this.pause();
    else requestAnimationFrame(() => this.#tick());
  }
}
