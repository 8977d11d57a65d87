"""Prints messages for the language server, with documents that are nested 14,000 levels deep.

With `--framed`, each has a header with its length, as editors send them.
"""

import json
import sys

NESTED = "module attributes {tai.x = " + "[" * 14000 + "]" * 14000 + "} {}"
REGIONS = "module {\n" * 14000 + "}\n" * 14000
BAD = "tai.kernel @k(%x: f32) -> f32 {\n  tai.return\n}"


def call(method: str, number: int | None = None, **params: object) -> dict[str, object]:
    message: dict[str, object] = {"jsonrpc": "2.0", "method": method, "params": params}
    return message if number is None else message | {"id": number}


def open_document(name: str, text: str) -> dict[str, object]:
    document = {"uri": f"test:///{name}", "languageId": "mlir", "version": 1, "text": text}
    return call("textDocument/didOpen", textDocument=document)


MESSAGES = [
    call("initialize", 0, processId=1, rootPath="mlir", capabilities={}, trace="off"),
    open_document("nested.mlir", NESTED),
    call(
        "textDocument/didChange",
        textDocument={"uri": "test:///nested.mlir", "version": 2},
        contentChanges=[{"text": REGIONS}],
    ),
    open_document("bad.mlir", BAD),
    call("shutdown", 3),
    call("exit"),
]
for message in MESSAGES:
    text = json.dumps(message)
    if "--framed" in sys.argv:
        sys.stdout.write(f"Content-Length: {len(text)}\r\n\r\n{text}")
    else:
        sys.stdout.write(f"{text}\n// -----\n")
