"use strict";
// The light as a picture of twice its width: left the mantissas, right the exponent, the observability and whether it
// was observed. Radiance = mantissa / 255 * 2^(exponent - 128).
(() => {
  const map = document.getElementById("map");
  const disc = document.getElementById("disc");
  const exposure = document.getElementById("exposure");
  const stops = document.getElementById("stops");
  const marks = document.getElementById("marks");
  const scale = Number(map.dataset.scale);
  const width = map.width, height = map.height;
  const source = new Image();

  const encoded = (value) => {
    const v = Math.min(Math.max(value, 0), 1);
    return 255 * (v <= 0.0031308 ? 12.92 * v : 1.055 * Math.pow(v, 1 / 2.4) - 0.055);
  };

  // where each pixel of the disc looks: an equal-area view of the upper hemisphere, +x right, +y up
  const looks = () => {
    const size = disc.width, where = new Int32Array(size * size).fill(-1);
    for (let row = 0; row < size; row++) {
      for (let column = 0; column < size; column++) {
        const x = (2 * column + 1) / size - 1, y = 1 - (2 * row + 1) / size, r = Math.hypot(x, y);
        if (r >= 1) continue;
        const theta = 2 * Math.asin(r / Math.SQRT2), u = 0.5 - Math.atan2(y, x) / (2 * Math.PI);
        const v = Math.min(Math.floor((theta / Math.PI) * height), height - 1);
        where[row * size + column] = v * width + (Math.floor(u * width) + width) % width;
      }
    }
    return where;
  };

  source.onload = () => {
    const raw = document.createElement("canvas");
    raw.width = 2 * width;
    raw.height = height;
    const paper = raw.getContext("2d", { willReadFrequently: true });
    paper.drawImage(source, 0, 0);
    const data = paper.getImageData(0, 0, 2 * width, height).data;
    const radiance = new Float32Array(3 * width * height);
    const state = new Uint8Array(width * height); // 0 determined, 1 not determined, 2 not observed
    const asked = "threshold" in map.dataset;
    for (let row = 0, pixel = 0; row < height; row++) {
      for (let column = 0; column < width; column++, pixel++) {
        const left = 4 * (row * 2 * width + column), right = left + 4 * width;
        const factor = Math.pow(2, data[right] - 128) / 255;
        for (let channel = 0; channel < 3; channel++) radiance[3 * pixel + channel] = data[left + channel] * factor;
        if (data[right + 2] > 127) state[pixel] = 2;
        else if (asked && data[right + 1] < 255 * Number(map.dataset.threshold)) state[pixel] = 1;
      }
    }
    const where = looks();
    const shown = new Uint8ClampedArray(4 * width * height);

    const put = (canvas, pixels, index) => {
      const image = new ImageData(canvas.width, canvas.height);
      const hatch = Math.max(8, Math.round(canvas.width / 80));
      for (let k = 0; k < canvas.width * canvas.height; k++) {
        const from = index === null ? k : index[k];
        if (from < 0) continue;
        const row = Math.floor(k / canvas.width), column = k % canvas.width, what = marks.checked ? state[from] : 0;
        const rising = (row + column) % hatch < 2, falling = (row - column + 8 * canvas.width) % hatch < 2;
        const line = (what === 1 && rising) || (what === 2 && (rising || falling));
        for (let channel = 0; channel < 3; channel++) {
          const value = pixels[4 * from + channel];
          image.data[4 * k + channel] = line ? value + 0.75 * (150 - value) : value;
        }
        image.data[4 * k + 3] = 255;
      }
      canvas.getContext("2d").putImageData(image, 0, 0);
    };

    const draw = () => {
      const factor = scale * Math.pow(2, Number(exposure.value));
      for (let pixel = 0; pixel < width * height; pixel++) {
        for (let channel = 0; channel < 3; channel++) {
          shown[4 * pixel + channel] = encoded(radiance[3 * pixel + channel] * factor);
        }
      }
      put(map, shown, null);
      put(disc, shown, where);
      const value = Number(exposure.value);
      stops.textContent = (value > 0 ? "+" : "") + value.toFixed(1) + " stops";
    };

    exposure.addEventListener("input", draw);
    marks.addEventListener("change", draw);
    draw();
    document.documentElement.dataset.ready = "yes";
  };
  source.src = map.dataset.light;
})();
