// Starts tai's language server for .mlir files, and shows adjoints of kernels.

const { CodeLens, Range, Uri, commands, languages, window, workspace } = require("vscode");
const { LanguageClient } = require("vscode-languageclient/node");
const { findFunctions, makeAdjoint } = require("./adjoint");

const LANGUAGE = { language: "tai-mlir" };
const SCHEME = "tai-adjoint";
let client;

/** Puts "show adjoint" above each kernel and each function to differentiate. */
const lenses = {
  provideCodeLenses(document) {
    return findFunctions(document.getText()).map(
      ({ name, line }) =>
        new CodeLens(new Range(line, 0, line, 0), {
          title: "show adjoint",
          command: "tai.showAdjoint",
          arguments: [document.uri.toString(), name],
        }),
    );
  },
};

/** The text of a document that holds an adjoint; the query names the file. */
const adjoints = {
  async provideTextDocumentContent(uri) {
    const document = await workspace.openTextDocument(Uri.parse(uri.query));
    const tool = workspace.getConfiguration("tai").get("opt");
    return makeAdjoint(tool, document.getText(), uri.fragment);
  },
};

async function showAdjoint(file, name) {
  const uri = Uri.from({ scheme: SCHEME, path: `${name}_grad.mlir`, query: file, fragment: name });
  const document = await workspace.openTextDocument(uri);
  await languages.setTextDocumentLanguage(document, LANGUAGE.language);
  await window.showTextDocument(document, { preview: true, viewColumn: -2 });
}

exports.activate = async function (context) {
  context.subscriptions.push(
    languages.registerCodeLensProvider({ ...LANGUAGE, scheme: "file" }, lenses),
    workspace.registerTextDocumentContentProvider(SCHEME, adjoints),
    commands.registerCommand("tai.showAdjoint", showAdjoint),
  );
  const command = workspace.getConfiguration("tai").get("server");
  client = new LanguageClient("tai", "tai", { command }, { documentSelector: [LANGUAGE] });
  context.subscriptions.push(client);
  await client.start();
};

exports.deactivate = () => client?.stop();
