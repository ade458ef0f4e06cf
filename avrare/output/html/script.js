"use strict";
(() => {
  const root = document.documentElement;
  const players = [];

  // Theme: the system's, or the reader's choice, stored if the browser allows it.
  const button = document.getElementById("theme");
  const themes = ["auto", "light", "dark"];
  const storedTheme = (value) => {
    try {
      if (value === undefined) return localStorage.getItem("avrare-theme");
      localStorage.setItem("avrare-theme", value);
    } catch { /* storage may be denied to files */ }
    return null;
  };
  const show = (theme) => {
    if (theme === "auto") root.removeAttribute("data-theme");
    else root.setAttribute("data-theme", theme);
    button.textContent = `Theme: ${theme}`;
    for (const player of players) player.draw();
  };
  let theme = themes.includes(storedTheme()) ? storedTheme() : "auto";
  button.addEventListener("click", () => {
    theme = themes[(themes.indexOf(theme) + 1) % themes.length];
    storedTheme(theme);
    show(theme);
  });

  const colour = (name) => getComputedStyle(root).getPropertyValue(`--${name}`).trim();
  const between = (values, at) => {
    const k = Math.min(Math.floor(at), values.length - 1), next = Math.min(k + 1, values.length - 1);
    return values[k] + (at - k) * (values[next] - values[k]);
  };

  // Top view of the road, with the ego at a third of the width.
  const topView = (canvas, data) => {
    const pen = canvas.getContext("2d");
    const { lanes, width: lane, ramp, borders, lines } = data.road;
    const low = lanes[0] - lane / 2, high = lanes[lanes.length - 1] + lane / 2;
    let ppm = 8, left = 0, wide = 0, tall = 0;
    const X = (x) => (x - left) * ppm;
    const Y = (y) => tall / 2 - (y - (low + high) / 2) * ppm;

    // The part of a line that is in view, to which dashes are measured out.
    const cut = (x, y) => {
      const from = left, to = left + wide / ppm, seen = [];
      for (let k = 1; k < x.length; k++) {
        if (x[k] < from || x[k - 1] > to) continue;
        const slope = (y[k] - y[k - 1]) / (x[k] - x[k - 1] || 1);
        if (x[k - 1] < from) seen.push([from, y[k - 1] + (from - x[k - 1]) * slope]);
        else if (!seen.length) seen.push([x[k - 1], y[k - 1]]);
        seen.push(x[k] > to ? [to, y[k - 1] + (to - x[k - 1]) * slope] : [x[k], y[k]]);
      }
      return seen;
    };
    const trace = (points) => points.forEach(([x, y], k) => pen[k ? "lineTo" : "moveTo"](X(x), Y(y)));

    // Lanes as far as they are there, the lines on them, and the stations below the lowest in view.
    const road = () => {
      let floor = Y(low);
      borders.forEach(([x, rightmost, leftmost], k) => {
        const below = cut(x, rightmost), above = cut(x, leftmost);
        pen.fillStyle = colour(ramp.includes(k) ? "ramp" : "road");
        pen.beginPath();
        trace([...below, ...above.reverse()]);
        pen.fill();
        for (const [, y] of below) floor = Math.max(floor, Y(y));
      });
      pen.strokeStyle = colour("marking");
      pen.lineWidth = 1.5;
      for (const [x, y, inner] of lines) {
        const points = cut(x, y);
        if (!points.length) continue;
        pen.setLineDash(inner ? [3 * ppm, 6 * ppm] : []);
        pen.lineDashOffset = points[0][0] * ppm;
        pen.beginPath();
        trace(points);
        pen.stroke();
      }
      pen.setLineDash([]);
      floor = Math.min(floor, tall - 24);
      pen.fillStyle = colour("muted");
      pen.font = "11px system-ui, sans-serif";
      pen.textAlign = "center";
      pen.textBaseline = "top";
      for (let x = Math.ceil(left / 20) * 20; X(x) < wide; x += 20) {
        pen.fillRect(X(x), floor + 4, 1, 4);
        if (X(x) > 14 && X(x) < wide - 22) pen.fillText(`${x} m`, X(x), floor + 10);
      }
    };

    const car = (x, y, h, l, w, fill, marked) => {
      pen.save();
      pen.translate(X(x), Y(y));
      pen.rotate(-h);
      pen.beginPath();
      pen.roundRect(-l / 2 * ppm, -w / 2 * ppm, l * ppm, w * ppm, Math.min(4, w * ppm / 4));
      pen.fillStyle = fill;
      pen.fill();
      if (marked) { pen.strokeStyle = colour("fail"); pen.lineWidth = 2.5; pen.stroke(); }
      pen.fillStyle = "rgba(255, 255, 255, .55)";
      pen.fillRect(l * ppm * .12, -w * ppm * .36, l * ppm * .13, w * ppm * .72);
      pen.restore();
    };

    // Label above the vehicle, or below it if another vehicle is in the way.
    const name = (words, x, y, w, fill, all) => {
      const occupied = all.some(([u, v]) => v > y + .5 && v < y + 1.5 * lane && Math.abs(u - x) * ppm < 46);
      pen.font = "600 11px system-ui, sans-serif";
      pen.textAlign = "center";
      pen.textBaseline = occupied ? "top" : "bottom";
      pen.lineWidth = 4;
      pen.lineJoin = "round";
      pen.strokeStyle = colour("road");
      const at = occupied ? Y(y) + w / 2 * ppm + 5 : Y(y) - w / 2 * ppm - 5;
      pen.strokeText(words, X(x), at);
      pen.fillStyle = fill;
      pen.fillText(words, X(x), at);
    };

    const path = (points, style, dash) => {
      if (!points || points.length < 2) return;
      pen.beginPath();
      points.forEach(([x, y], k) => k ? pen.lineTo(X(x), Y(y)) : pen.moveTo(X(x), Y(y)));
      pen.setLineDash(dash);
      pen.strokeStyle = style;
      pen.lineWidth = 2;
      pen.stroke();
      pen.setLineDash([]);
    };

    const observed = (k) => {
      const seen = data.seen[k];
      if (!seen) return;
      pen.strokeStyle = pen.fillStyle = colour("observed");
      seen.forEach((at, v) => {
        const other = data.others[v];
        pen.beginPath();
        if (at) {
          pen.arc(X(at[0]), Y(at[1]), 4, 0, 7);
          pen.fill();
          pen.lineWidth = 1.5;
          pen.strokeStyle = colour("road");
          pen.stroke();
          pen.strokeStyle = colour("observed");
        } else {
          pen.lineWidth = 1.5;
          pen.setLineDash([4, 3]);
          pen.arc(X(other.x[k]), Y(other.y[k]), .62 * other.l * ppm, 0, 7);
          pen.stroke();
          pen.setLineDash([]);
        }
      });
    };

    return (t) => {
      const ratio = window.devicePixelRatio || 1;
      wide = canvas.clientWidth; tall = canvas.clientHeight;
      if (!wide) return;
      if (canvas.width !== Math.round(wide * ratio)) canvas.width = Math.round(wide * ratio);
      if (canvas.height !== Math.round(tall * ratio)) canvas.height = Math.round(tall * ratio);
      pen.setTransform(ratio, 0, 0, ratio, 0, 0);
      pen.clearRect(0, 0, wide, tall);
      ppm = Math.min(Math.max(wide / 105, 6.4), (tall - 46) / (high - low));
      left = between(data.ego.x, t) - wide / ppm * .36;
      road();
      const k = Math.round(t);
      if (data.predicted && data.predicted[k])
        for (const points of data.predicted[k]) path(points, colour("predicted"), [2, 4]);
      const ego = data.ego, all = [ego, ...data.others].map((one) => [between(one.x, t), between(one.y, t)]);
      [ego, ...data.others].forEach((one, v) => {
        const fill = colour(v === 0 ? "accent" : one.marked ? "fail" : "muted");
        name(v === 0 ? "ego" : one.name, ...all[v], one.w, fill, all);
      });
      if (data.plan && data.plan[k]) path(data.plan[k], colour("accent"), []);
      for (const one of data.others) {
        const fill = colour(one.moving ? "vehicle" : "parked");
        car(between(one.x, t), between(one.y, t), between(one.h, t), one.l, one.w, fill, one.marked);
      }
      car(...all[0], between(ego.h, t), ego.l, ego.w, colour("accent"), false);
      observed(k);
      pen.fillStyle = colour("muted");
      pen.font = "12px system-ui, sans-serif";
      pen.textAlign = "left"; pen.textBaseline = "top";
      pen.fillText(`ego ${between(ego.v, t).toFixed(1)} m/s`, 10, 8);
    };
  };

  const player = (box) => {
    const data = JSON.parse(box.querySelector("script").textContent);
    const canvas = box.querySelector("canvas");
    const paint = canvas && data.road ? topView(canvas, data) : () => {};
    const play = box.querySelector(".play"), slider = box.querySelector("input");
    const clock = box.querySelector("output"), speedButton = box.querySelector(".speed");
    const cursors = box.querySelectorAll(".cursor");
    const last = data.samples - 1;
    const speeds = [1, .5, .25, 2];
    let t = Number(box.dataset.start), speed = 1, playingSince = null;

    const draw = () => {
      slider.value = Math.round(t);
      clock.textContent = `${(t * data.dt).toFixed(2)} s`;
      const at = `${100 * (t + .5) / data.samples}%`;
      for (const one of cursors) one.style.left = at;
      paint(t);
    };
    const stop = () => { playingSince = null; play.textContent = "Play"; };
    const move = (now) => {
      if (playingSince === null) return;
      t += (now - playingSince) / 1000 * speed / data.dt;
      playingSince = now;
      if (t >= last) { t = last; stop(); }
      draw();
      if (playingSince !== null) requestAnimationFrame(move);
    };
    play.addEventListener("click", () => {
      if (playingSince !== null) { t = Math.round(t); stop(); draw(); return; }
      if (t >= last) t = Number(box.dataset.start);
      playingSince = performance.now();
      play.textContent = "Pause";
      requestAnimationFrame(move);
    });
    slider.addEventListener("input", () => { stop(); t = Number(slider.value); draw(); });
    speedButton.addEventListener("click", () => {
      speed = speeds[(speeds.indexOf(speed) + 1) % speeds.length];
      speedButton.textContent = `${speed}×`;
    });
    for (const area of box.querySelectorAll(".over-time .area")) {
      const go = (event) => {
        const frame = area.getBoundingClientRect();
        const at = Math.floor((event.clientX - frame.left) / frame.width * data.samples);
        stop();
        t = Math.min(Math.max(at, 0), last);
        draw();
      };
      area.addEventListener("pointerdown", go);
      area.addEventListener("pointermove", (event) => { if (event.buttons) go(event); });
    }
    if (canvas && window.ResizeObserver) new ResizeObserver(draw).observe(canvas);
    draw();
    return { draw };
  };

  // The section in view is marked in the navigation.
  const links = [...document.querySelectorAll("nav a")];
  const targets = links.map((one) => document.getElementById(one.hash.slice(1)));
  const locate = () => {
    let here = 0;
    targets.forEach((one, k) => { if (one && one.getBoundingClientRect().top < innerHeight / 3) here = k; });
    links.forEach((one, k) => one.classList.toggle("here", k === here));
    const nav = links[here].parentElement, left = links[here].offsetLeft - nav.clientWidth / 2 + links[here].clientWidth / 2;
    if (nav.scrollWidth > nav.clientWidth) nav.scrollLeft = left;
  };
  let waiting = false;
  addEventListener("scroll", () => {
    if (waiting) return;
    waiting = true;
    requestAnimationFrame(() => { waiting = false; locate(); });
  }, { passive: true });
  locate();

  for (const box of document.querySelectorAll(".player")) players.push(player(box));
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => show(theme));
  show(theme);
  document.body.dataset.ready = String(players.length);
})();
