// The kernels and functions of a file, and the text of their adjoints as tai-opt makes them.

const { execFile } = require("child_process");

/** Each kernel, and each function that asks for a derivative: its name and its line, from 0. */
exports.findFunctions = function (text) {
  const found = [];
  const lines = text.split("\n");
  lines.forEach((line, number) => {
    const match = /^\s*(tai\.kernel|func\.func)\s+(?:(?:private|public|nested)\s+)?@([\w$.-]+)\(/.exec(line);
    if (!match) return;
    if (match[1] === "func.func") {
      // Its attributes may stand on later lines, before the body.
      let header = line;
      for (let i = number + 1; i < lines.length && !/\{\s*$/.test(header) && i < number + 20; ++i)
        header += lines[i];
      if (!header.includes("tai.differentiate")) return;
    }
    found.push({ name: match[2], line: number });
  });
  return found;
};

/** The ops of `text` that define a symbol whose name begins with `name`, or an error. */
exports.pickFunctions = function (text, name) {
  const lines = text.split("\n");
  const picked = [];
  let end = null;
  for (const line of lines) {
    if (end === null) {
      const match = /^(\s*)(?:tai\.kernel|func\.func)\s+(?:private\s+)?@([\w$.-]+)\(/.exec(line);
      if (!match || !match[2].startsWith(name + "_")) continue;
      if (!line.trimEnd().endsWith("{")) continue;
      end = match[1] + "}";
    }
    picked.push(line);
    if (line.trimEnd() === end) end = null;
  }
  return picked.join("\n");
};

/** A promise of the adjoint of `name`, or of the reason why there is none. */
exports.makeAdjoint = function (tool, text, name) {
  return new Promise((resolve) => {
    const options = ["-", `--tai-autodiff=kernel=${name}`];
    const child = execFile(tool, options, { maxBuffer: 1 << 26 }, (error, made, said) => {
      if (error) resolve(`// ${(said || error.message).trim().split("\n").join("\n// ")}\n`);
      else resolve(exports.pickFunctions(made, name) || `// '@${name}' has an adjoint already\n`);
    });
    child.stdin.on("error", () => {});
    child.stdin.end(text);
  });
};
