// RUN: not tai-run %s 2>&1 | FileCheck %s

// A check that fails ends the program with both numbers and the place.

func.func @main() {
  %a = arith.constant 1.0 : f64
  %b = arith.constant 1.25 : f64
  tai_check.close %a, %a tolerance 1.0e-9 : f64
  // CHECK: check-close.mlir:[[@LINE+2]]:3: error: check failed: got 1{{.*}}, expected 1.25
  // CHECK-NEXT: tai_check.close %a, %b
  tai_check.close %a, %b tolerance 0.1 : f64
  return
}
