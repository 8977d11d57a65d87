// Starts tai's language server for .mlir files.

const { workspace } = require("vscode");
const { LanguageClient } = require("vscode-languageclient/node");

let client;

exports.activate = async function (context) {
  const command = workspace.getConfiguration("tai").get("server");
  client = new LanguageClient(
    "tai",
    "tai",
    { command },
    { documentSelector: [{ language: "tai-mlir" }] },
  );
  context.subscriptions.push(client);
  await client.start();
};

exports.deactivate = () => client?.stop();
