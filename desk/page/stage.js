// The picture on the canvas: zoom, pan, the magnifier, and the mouse in the picture's pixels.

/** @typedef {import("./types.js").Px} Px */
/**
 * How the picture lies on a canvas: screen = scale * picture + origin.
 * @typedef {{scale: number, x: number, y: number}} Placed
 */
/**
 * A receiver of the mouse.
 * @typedef {Object} Hand
 * @property {(at: Px, event: PointerEvent) => void} down
 * @property {(at: Px, event: PointerEvent) => void} move
 * @property {(at: Px, event: PointerEvent) => void} up
 * @property {(at: Px) => void} finish
 */

/** Radius of the magnifier, screen px, and how much more it enlarges. */
const LOUPE = 74;
const LOUPE_FACTOR = 4;
const MOST_SCALE = 24;

/** @param {Placed} placed @param {Px} p @returns {Px} */
export const toScreen = (placed, p) => [placed.scale * p[0] + placed.x, placed.scale * p[1] + placed.y];

export class Stage {
  /**
   * @param {HTMLCanvasElement} canvas
   * @param {Hand} hand
   */
  constructor(canvas, hand) {
    this.canvas = canvas;
    this.hand = hand;
    const context = canvas.getContext("2d");
    if (!context) throw new Error("this browser draws no canvas");
    this.context = context;
    /** @type {Placed} */
    this.placed = { scale: 1, x: 0, y: 0 };
    /** @type {HTMLImageElement | null} */
    this.image = null;
    /** Offset of the shown picture's middle from the backdrop's, px. @type {Px} */
    this.shift = [0, 0];
    /** @type {[number, number]} */
    this.size = [1, 1];
    /** @type {((context: CanvasRenderingContext2D, placed: Placed) => void)[]} */
    this.painters = [];
    /** @type {Px | null} */
    this.mouse = null;
    this.loupe = false;
    /** Whether the user has zoomed, so that a new size of the window leaves it. */
    this.isFitted = true;
    this.space = false;
    this.asked = false;
    /** @type {{x: number, y: number} | null} */
    this.panning = null;
    this.listen();
  }

  /** @param {HTMLImageElement} image @param {Px} shift */
  show(image, shift) {
    this.image = image;
    this.shift = shift;
    this.paint();
  }

  /** @param {Px} p @returns {Px} */
  toPicture(p) {
    const { scale, x, y } = this.placed;
    return [(p[0] - x) / scale, (p[1] - y) / scale];
  }

  fit() {
    const { clientWidth: w, clientHeight: h } = this.canvas;
    const scale = Math.min(w / this.size[0], h / this.size[1]);
    this.placed = { scale, x: (w - scale * this.size[0]) / 2, y: (h - scale * this.size[1]) / 2 };
    this.isFitted = true;
    this.paint();
  }

  /** @param {number} factor @param {Px} [about] */
  zoom(factor, about) {
    const { clientWidth: w, clientHeight: h } = this.canvas;
    const [x, y] = about ?? this.mouse ?? [w / 2, h / 2];
    const least = 0.5 * Math.min(w / this.size[0], h / this.size[1]);
    const scale = Math.min(MOST_SCALE, Math.max(least, this.placed.scale * factor));
    const real = scale / this.placed.scale;
    this.placed = { scale, x: x - real * (x - this.placed.x), y: y - real * (y - this.placed.y) };
    this.isFitted = false;
    this.paint();
  }

  /** @param {number} dx @param {number} dy */
  pan(dx, dy) {
    this.placed = { ...this.placed, x: this.placed.x + dx, y: this.placed.y + dy };
    this.isFitted = false;
    this.paint();
  }

  paint() {
    if (this.asked) return;
    this.asked = true;
    requestAnimationFrame(() => {
      this.asked = false;
      this.draw();
    });
  }

  draw() {
    const { canvas, context } = this;
    const ratio = window.devicePixelRatio || 1;
    const [w, h] = [canvas.clientWidth, canvas.clientHeight];
    if (canvas.width !== Math.round(w * ratio) || canvas.height !== Math.round(h * ratio)) {
      canvas.width = Math.round(w * ratio);
      canvas.height = Math.round(h * ratio);
    }
    context.setTransform(ratio, 0, 0, ratio, 0, 0);
    context.clearRect(0, 0, w, h);
    this.drawPicture(this.placed);
    this.painters.forEach((painter) => painter(context, this.placed));
    if (this.loupe && this.mouse && !this.panning) this.drawLoupe(this.mouse, w, h);
  }

  /** @param {Placed} placed */
  drawPicture(placed) {
    if (!this.image) return;
    const [x, y] = toScreen(placed, [-this.shift[0], -this.shift[1]]);
    this.context.imageSmoothingEnabled = placed.scale < 6;
    this.context.imageSmoothingQuality = "high";
    this.context.drawImage(this.image, x, y, placed.scale * this.size[0], placed.scale * this.size[1]);
  }

  /**
   * The surroundings of the mouse, enlarged, beside it.
   * @param {Px} mouse @param {number} w @param {number} h
   */
  drawLoupe(mouse, w, h) {
    const { context } = this;
    const aside = LOUPE + 26;
    const cx = mouse[0] + aside + LOUPE < w ? mouse[0] + aside : mouse[0] - aside;
    const cy = mouse[1] - aside - LOUPE > 0 ? mouse[1] - aside : mouse[1] + aside;
    const at = this.toPicture(mouse);
    const scale = Math.max(this.placed.scale * LOUPE_FACTOR, 8);
    const placed = { scale, x: cx - scale * at[0], y: cy - scale * at[1] };
    context.save();
    context.beginPath();
    context.arc(cx, cy, LOUPE, 0, 2 * Math.PI);
    context.fillStyle = "#000";
    context.fill();
    context.clip();
    this.drawPicture(placed);
    this.painters.forEach((painter) => painter(context, placed));
    context.strokeStyle = "#ffffffb0";
    context.lineWidth = 1;
    context.beginPath();
    for (const [dx, dy] of [[1, 0], [-1, 0], [0, 1], [0, -1]]) {
      context.moveTo(cx + 4 * dx, cy + 4 * dy);
      context.lineTo(cx + LOUPE * dx, cy + LOUPE * dy);
    }
    context.stroke();
    context.restore();
    context.beginPath();
    context.arc(cx, cy, LOUPE, 0, 2 * Math.PI);
    context.strokeStyle = "#35c2ad";
    context.lineWidth = 2;
    context.stroke();
  }

  listen() {
    const { canvas } = this;
    /** @param {MouseEvent} event @returns {Px} */
    const place = (event) => {
      const box = canvas.getBoundingClientRect();
      return [event.clientX - box.left, event.clientY - box.top];
    };
    canvas.addEventListener("pointerdown", (event) => {
      canvas.focus({ preventScroll: true });
      canvas.setPointerCapture(event.pointerId);
      this.mouse = place(event);
      if (event.button === 1 || (event.button === 0 && this.space)) {
        this.panning = { x: event.clientX, y: event.clientY };
        event.preventDefault();
      } else if (event.button === 0) {
        this.hand.down(this.toPicture(this.mouse), event);
      }
    });
    // A press would take the focus from the field that a click has opened.
    canvas.addEventListener("mousedown", (event) => event.preventDefault());
    canvas.addEventListener("pointermove", (event) => {
      this.mouse = place(event);
      if (this.panning) {
        this.pan(event.clientX - this.panning.x, event.clientY - this.panning.y);
        this.panning = { x: event.clientX, y: event.clientY };
      } else {
        this.hand.move(this.toPicture(this.mouse), event);
        this.paint();
      }
    });
    canvas.addEventListener("pointerup", (event) => {
      if (this.panning) this.panning = null;
      else if (event.button === 0) this.hand.up(this.toPicture(place(event)), event);
      this.paint();
    });
    canvas.addEventListener("pointerleave", () => {
      this.mouse = null;
      this.paint();
    });
    canvas.addEventListener("dblclick", (event) => this.hand.finish(this.toPicture(place(event))));
    canvas.addEventListener("contextmenu", (event) => {
      event.preventDefault();
      this.hand.finish(this.toPicture(place(event)));
    });
    canvas.addEventListener(
      "wheel",
      (event) => {
        event.preventDefault();
        this.zoom(Math.exp(-event.deltaY * 0.0016), place(event));
      },
      { passive: false },
    );
    new ResizeObserver(() => (this.isFitted ? this.fit() : this.paint())).observe(canvas);
  }
}
