/* The page's own script: uploads, the before-and-after slider, the view. It talks to this server only. */
window.straightlens = (() => {
  const CAPTIONS = {
    curves: "Curves that were found: dark to bright by how far off straight the lens leaves them; " +
            "dashed ones were not taken for straight lines.",
    lines: "Where the network sees lines: brighter is surer.",
  };
  let stem = "picture"; // of the file's name; never leaves the browser
  let shown = { name: "" }; // the picture on the page
  let view = {}; // {fov: degrees} or {balance: 0 to 1}
  let redraw = () => {};

  /* ---- taking a picture in ---- */

  function drop(element, props, trigger, event) {
    const label = element.querySelector(".sl-drop");
    const input = label.querySelector("input");
    const complaint = element.querySelector(".sl-complaint");
    const complain = (words) => {
      complaint.textContent = words;
      complaint.hidden = !words;
    };
    const send = async (file) => {
      if (!file) return;
      complain("");
      if (file.size > Number(label.dataset.maxBytes)) {
        complain("This file is larger than the page takes.");
        return;
      }
      label.classList.add("sl-busy");
      try {
        const answer = await fetch("pictures", { method: "POST", body: file });
        const said = await answer.json();
        if (!answer.ok) throw new Error(said.error);
        stem = file.name.replace(/\.[^.]*$/, "") || "picture";
        label.classList.add("sl-small");
        props.value = said.name;
        trigger(event);
      } catch (error) {
        complain(error instanceof TypeError ? "The server cannot be reached." : error.message);
      } finally {
        label.classList.remove("sl-busy");
        input.value = "";
      }
    };
    input.addEventListener("change", () => send(input.files[0]));
    for (const name of ["dragenter", "dragover", "dragleave", "drop"]) {
      document.addEventListener(name, (dragged) => {
        dragged.preventDefault();
        label.classList.toggle("sl-over", name === "dragenter" || name === "dragover");
        if (name === "drop") send(dragged.dataTransfer.files[0]);
      });
    }
    document.addEventListener("paste", (pasted) => send(pasted.clipboardData.files[0]));
  }

  /* ---- looking at it ---- */

  function viewer(element, props, watch) {
    const find = (name) => element.querySelector(name);
    const stage = find(".sl-stage");
    const [after, before, still] = [".sl-after", ".sl-before", ".sl-still"].map(find);
    const [caption, slide] = [".sl-caption", ".sl-slide"].map(find);
    const tabs = [...element.querySelectorAll("[data-tab]")];
    let spoken = ""; // what the caption says of the view
    let [loading, again] = [false, false];
    let across = 90; // degrees

    slide.addEventListener("input", () => stage.style.setProperty("--at", slide.value + "%"));
    tabs.forEach((tab) => tab.addEventListener("click", () => select(tab.dataset.tab)));

    function select(name) {
      tabs.forEach((tab) => tab.setAttribute("aria-selected", String(tab.dataset.tab === name)));
      const compare = name === "compare";
      stage.dataset.shows = compare && shown.lens ? "both" : compare ? "before" : "still";
      still.hidden = compare;
      if (!compare) still.src = `pictures/${shown.name}/${name}.jpg?of=${Date.now()}`;
      caption.textContent = compare ? spoken : CAPTIONS[name];
    }

    // One request at a time; the newest view is the one that is asked for next.
    async function load() {
      if (loading) {
        again = true;
        return across;
      }
      loading = true;
      const of = shown.name;
      const answer = await fetch(`pictures/${of}/after.jpg?${new URLSearchParams(view)}`);
      if (answer.ok && of === shown.name) {
        const old = after.src;
        after.src = URL.createObjectURL(await answer.blob());
        if (old.startsWith("blob:")) URL.revokeObjectURL(old);
        across = Number(answer.headers.get("X-Degrees-Across"));
        say(`Shows ${across.toFixed(1)}° across` + (view.fov ? "." : `, framed by balance ${view.balance ?? 0}.`));
      } else if (!answer.ok) {
        say((await answer.json()).error);
      }
      loading = false;
      if (again) {
        again = false;
        return load();
      }
      return across;
    }

    function say(words) {
      spoken = words;
      if (still.hidden) caption.textContent = words;
    }

    function update() {
      const value = props.value;
      if (!value || !value.name) return;
      if (value.name !== shown.name) before.src = `pictures/${value.name}/before.jpg`;
      shown = value;
      view = {};
      stage.style.aspectRatio = `${value.width} / ${value.height}`;
      stage.style.maxWidth = `calc(76vh * ${value.width / value.height})`;
      mark("balance");
      stage.classList.toggle("sl-busy", value.busy);
      tabs[1].hidden = !value.curves;
      tabs[2].hidden = !value.lines;
      say(value.busy ? "Looking for the lens …" : value.lens ? "" : "No lens: the picture as it came.");
      select("compare");
      if (value.lens) load();
    }

    redraw = load;
    watch("value", update);
    update();
  }

  async function frame(option, value) {
    view = { [option]: value };
    mark(option);
    return Math.round(await redraw());
  }

  /* ---- taking files away: each link is completed when it is about to be used ---- */

  for (const event of ["pointerdown", "focusin", "click"]) {
    document.addEventListener(event, (used) => {
      const link = used.target.closest?.("a[data-file]");
      if (!link) return;
      link.href = `pictures/${shown.name}/${link.dataset.file}?${new URLSearchParams(view)}`;
      link.download = `${stem}.${link.dataset.file}`;
    }, true);
  }

  // Of the two sliders the one moved last counts; the other is dimmed.
  function mark(option) {
    for (const name of ["fov", "balance"]) {
      document.getElementById(`sl-${name}`)?.classList.toggle("sl-idle", name !== option);
    }
  }

  return { drop, viewer, frame };
})();
