// Return what makes a page hard to read: text with a contrast below 4.5, below 10 px, over other text of a figure or in
// literal backticks; wrong plurals, missing values in sentences, numbers and units broken across lines; colour keys with a
// contrast below 3; anything beyond the page's edge or its own scroller.
({ phone }) => {
  const faults = [];
  const visible = (node) => node.checkVisibility({ visibilityProperty: true, opacityProperty: true });
  const shown = (node) => node.closest(".unseen") === null && visible(node);
  const short = (text) => JSON.stringify(text.trim().replace(/\s+/g, " ").slice(0, 60));

  // --- edges ---
  const wide = document.documentElement.scrollWidth;
  if (wide > innerWidth) faults.push(`the page is ${wide} px wide in a window of ${innerWidth}`);
  for (const each of document.querySelectorAll(".scroll")) {
    const figure = each.querySelector("svg") !== null; // may be scrolled on a phone, with a line that says so
    const hint = each.previousElementSibling?.matches(".sideways") && shown(each.previousElementSibling);
    if (shown(each) && each.scrollWidth > each.clientWidth + 1 && !(phone && figure && hint)) {
      faults.push(`${figure ? "figure" : "table"} of ${each.scrollWidth} px in ${each.clientWidth}: ${short(each.textContent)}`);
    }
  }

  // --- backticks ---
  for (const text of [document.title, document.body.innerText, ...[...document.querySelectorAll("svg text")].map((each) => each.textContent)]) {
    const found = /.{0,20}`.{0,20}/.exec(text);
    if (found) faults.push(`backtick: ${short(found[0])}`);
  }

  // --- wording ---
  for (const each of document.querySelectorAll("h1, h2, p, li, caption, figcaption")) {
    const found = /\bnan\b|(^|\s)- (%|ms|Hz)|(?<![\d.,:-])1 [a-z]+[^\Ws]s\b/i.exec(each.innerText);
    if (found && shown(each)) faults.push(`wording: ${short(each.innerText.slice(found.index))}`);
  }

  // --- text over text, in figures ---
  for (const svg of document.querySelectorAll("svg")) {
    const texts = [...svg.querySelectorAll("text")].filter((each) => each.textContent.trim());
    const boxes = texts.map((each) => each.getBoundingClientRect());
    texts.forEach((text, k) => {
      for (let j = 0; j < k; j++) {
        const across = Math.min(boxes[j].right, boxes[k].right) - Math.max(boxes[j].left, boxes[k].left);
        const down = Math.min(boxes[j].bottom, boxes[k].bottom) - Math.max(boxes[j].top, boxes[k].top);
        if (across > 1 && down > 3) faults.push(`overlap: ${short(texts[j].textContent)} and ${short(text.textContent)}`);
      }
    });
  }

  // --- contrast and size ---
  const pen = Object.assign(document.createElement("canvas"), { width: 1, height: 1 }).getContext("2d", { willReadFrequently: true });
  const paint = (ground, colour, opacity = 1) => {
    pen.globalAlpha = 1;
    pen.fillStyle = `rgb(${ground})`;
    pen.fillRect(0, 0, 1, 1);
    pen.globalAlpha = opacity;
    pen.fillStyle = colour;
    pen.fillRect(0, 0, 1, 1);
    return [...pen.getImageData(0, 0, 1, 1).data.slice(0, 3)];
  };
  const light = (colour) => {
    const [r, g, b] = colour.map((each) => (each / 255 <= 0.03928 ? each / 255 / 12.92 : ((each / 255 + 0.055) / 1.055) ** 2.4));
    return 0.2126 * r + 0.7152 * g + 0.0722 * b;
  };
  const contrast = (one, other) => {
    const [low, high] = [light(one), light(other)].sort((a, b) => a - b);
    return (high + 0.05) / (low + 0.05);
  };
  // Return the colour under an element: that of its ancestors, and of the shapes of its figure below its centre.
  const under = (node) => {
    const line = [];
    for (let each = node; each; each = each.parentElement) line.unshift(each);
    let ground = [255, 255, 255];
    for (const each of line) ground = paint(ground, getComputedStyle(each).backgroundColor);
    const svg = node.closest("svg");
    if (!svg) return ground;
    const box = node.getBoundingClientRect(), x = box.left + box.width / 2, y = box.top + box.height / 2;
    for (const shape of svg.querySelectorAll("path, rect")) {
      const style = getComputedStyle(shape), place = shape.getBoundingClientRect();
      const covers = place.left <= x && x <= place.right && place.top <= y && y <= place.bottom;
      if (!covers || shape.closest("defs, clipPath") || style.fill === "none") continue;
      ground = paint(ground, style.fill, Number(style.opacity) * Number(style.fillOpacity));
    }
    return ground;
  };
  const opacity = (node) => {
    let product = 1;
    for (let each = node; each; each = each.parentElement) product *= Number(getComputedStyle(each).opacity);
    return product;
  };
  const walker = document.createTreeWalker(document.body, NodeFilter.SHOW_TEXT);
  while (walker.nextNode()) {
    const node = walker.currentNode.parentElement, text = walker.currentNode.data;
    const whole = /\b[cm]?m\/s\b|^[-−]?\d[\d.,]*\d$/.exec(text), range = document.createRange();
    if (whole && shown(node)) {
      range.setStart(walker.currentNode, whole.index);
      range.setEnd(walker.currentNode, whole.index + whole[0].length);
      const lines = new Set([...range.getClientRects()].map((each) => Math.round(each.top)));
      if (lines.size > 1) faults.push(`broken: ${short(text)}`);
    }
    if (!text.trim() || node.closest("script, style, noscript, option, metadata, defs") || !shown(node)) continue;
    const style = getComputedStyle(node), inSvg = node.closest("svg"), ground = under(node);
    const ratio = contrast(paint(ground, inSvg ? style.fill : style.color, opacity(node)), ground);
    if (ratio < 4.5) faults.push(`contrast ${ratio.toFixed(2)}: ${short(text)}`);
    const size = parseFloat(style.fontSize) * (inSvg ? (node.getScreenCTM()?.a || node.getScreenCTM()?.b || 1) : 1);
    if (Math.abs(size) < 10) faults.push(`${Math.abs(size).toFixed(1)} px: ${short(text)}`);
  }

  // --- colour keys ---
  for (const key of document.querySelectorAll(".pad .key")) {
    const ground = under(key), ratio = contrast(paint(ground, getComputedStyle(key).color, opacity(key)), ground);
    if (shown(key) && ratio < 3) faults.push(`contrast ${ratio.toFixed(2)} of the colour key: ${short(key.parentElement.textContent)}`);
  }
  return faults;
}
