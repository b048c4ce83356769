"use strict";

// How the run was made: stages, facts and the command.

function stageTable() {
  const longest = Math.max(...page.stages.map((stage) => stage.seconds || 0), 1e-9);
  const rows = page.stages.map((stage) => {
    const bar = element("div", {className: "share"});
    bar.style.width = `${100 * (stage.seconds || 0) / longest}%`;
    return element("tr", {}, element("td", {}, stage.stage), element("td", {className: "bar-cell"}, bar),
      element("td", {className: "number"}, secondsText(stage.seconds || 0)),
      element("td", {className: "number"}, stage.peak_bytes ? bytesText(stage.peak_bytes) : ""));
  });
  const seconds = page.stages.reduce((sum, stage) => sum + (stage.seconds || 0), 0);
  const peak = Math.max(...page.stages.map((stage) => stage.peak_bytes || 0));
  rows.push(element("tr", {className: "sum"}, element("td", {}, "all"), element("td", {}),
    element("td", {className: "number"}, secondsText(seconds)), element("td", {className: "number"}, peak ? bytesText(peak) : "")));
  return element("table", {id: "stages"},
    element("thead", {}, element("tr", {}, element("th", {}, "Stage"), element("th", {}), element("th", {className: "number"}, "Time"), element("th", {className: "number"}, "Memory"))),
    element("tbody", {}, ...rows));
}

function factTable() {
  const rows = page.facts.map(([name, text]) => element("tr", {}, element("th", {}, name), element("td", {}, text)));
  return element("table", {id: "facts"}, element("tbody", {}, ...rows));
}

function commandBox() {
  const text = element("pre", {id: "command"}, page.command);
  const copy = button("Copy", "Copy the command", async () => {
    try {
      await navigator.clipboard.writeText(page.command);
      copy.textContent = "Copied";
      setTimeout(() => { copy.textContent = "Copy"; }, 1500);
    } catch (error) {
      // Without the right to the clipboard the text is at least marked.
      window.getSelection().selectAllChildren(text);
    }
  });
  return element("div", {className: "command"}, element("div", {className: "hint"}, "The command that makes this again; folders stand here by their last names: put yours in their place."), text, copy);
}

function showMaking(main) {
  const columns = element("div", {className: "made"});
  if (page.stages.length > 0) columns.append(stageTable());
  if (page.facts.length > 0) columns.append(factTable());
  main.append(section("How it was made", "", columns, page.command ? commandBox() : null));
}
