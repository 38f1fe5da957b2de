(() => {
  "use strict";
  const colour = name => getComputedStyle(document.documentElement).getPropertyValue(name).trim();
  const plots = [...document.querySelectorAll(".plot")];
  const eyeOf = plot => plot._fullLayout.scene._scene.getCamera().eye;
  let following = false;
  const follow = (plot, camera) => {
    const other = document.getElementById(plot.dataset.pair);
    if (!other || !other.dataset.drawn || following || !camera || !camera.eye) return;
    following = true;
    Plotly.relayout(other, {"scene.camera": camera}).then(() => { following = false; });
  };
  const draw = plot => {
    if (plot.dataset.drawn) return;
    plot.dataset.drawn = "begun";
    const figure = JSON.parse(document.getElementById(plot.id + "-data").textContent);
    figure.layout.font = Object.assign({}, figure.layout.font, {color: colour("--text")});
    // No button that would send a figure's data anywhere.
    const settings = {responsive: true, displaylogo: false, scrollZoom: false, plotlyServerURL: "",
                      modeBarButtonsToRemove: ["sendChartToCloud", "downloadJson", "select2d", "lasso2d",
                                               "tableRotation", "resetCameraLastSave3d"]};
    Plotly.newPlot(plot, figure.data, figure.layout, settings).then(() => {
      plot.dataset.drawn = "yes";
      if (plot.dataset.pair) plot.on("plotly_relayout", change => follow(plot, change["scene.camera"]));
    });
  };
  const seen = new IntersectionObserver(entries => {
    for (const entry of entries) if (entry.isIntersecting) { seen.unobserve(entry.target); draw(entry.target); }
  }, {rootMargin: "600px"});
  plots.forEach(plot => seen.observe(plot));
  // The style of a printing page fits A4 and Letter. Plots.resize would wait until after the print.
  const printing = starts => {
    document.documentElement.classList.toggle("printing", starts);
    for (const plot of plots.filter(each => each.offsetParent)) {
      if (plot.dataset.drawn === "yes") Plotly.relayout(plot, {autosize: true}); else if (starts) draw(plot);
    }
  };
  addEventListener("beforeprint", () => printing(true));
  addEventListener("afterprint", () => printing(false));
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => {
    for (const plot of plots) if (plot.dataset.drawn === "yes") {
      Plotly.relayout(plot, {"font.color": colour("--text")});
    }
  });
  const turned = (eye, azimuth, tilt, zoom) => {
    const distance = Math.hypot(eye.x, eye.y, eye.z) * zoom;
    const around = Math.atan2(eye.y, eye.x) + azimuth;
    const above = Math.asin(eye.z / Math.hypot(eye.x, eye.y, eye.z)) + tilt;
    const up = Math.max(-1.5, Math.min(1.5, above));
    return {x: distance * Math.cos(up) * Math.cos(around), y: distance * Math.cos(up) * Math.sin(around),
            z: distance * Math.sin(up)};
  };
  document.addEventListener("click", event => {
    const button = event.target.closest("button[data-turn]");
    if (!button) return;
    const [azimuth, tilt, zoom] = button.dataset.turn.split(",").map(Number);
    const plot = document.getElementById(button.parentElement.dataset.plot);
    draw(plot);
    if (plot.dataset.drawn !== "yes") return;
    Plotly.relayout(plot, {"scene.camera": {eye: turned(eyeOf(plot), azimuth, tilt, zoom)}});
  });
})();
