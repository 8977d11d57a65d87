// RUN: not tai-run %s 2>&1 | FileCheck %s

// A file that does not parse is one error at its place.

func.func @main() {
  // CHECK: malformed.mlir:[[@LINE+2]]:{{[0-9]+}}: error: {{.*}}
  // CHECK-NEXT: tai.launch @step( : () -> ()
  tai.launch @step( : () -> ()
  return
}
