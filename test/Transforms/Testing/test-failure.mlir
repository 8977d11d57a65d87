// RUN: split-file %s %t
// RUN: not tai-opt %t/scene.mlir --tai-test-failure 2>&1 | FileCheck %s --allow-empty --check-prefix=SILENT
// RUN: not tai-opt %t/scene.mlir --tai-test-failure=invalid=true 2>&1 | FileCheck %s --check-prefix=INVALID
// RUN: tai-opt %t/others.mlir --tai-test-failure | FileCheck %s --check-prefix=OTHERS
// RUN: not tai-opt %t/scene.mlir --tai-test-failure=valid=true 2>&1 | FileCheck %s --check-prefix=OPTION

// The pass fails without a diagnostic in a module of tai, or leaves an op outside of any kernel.
// SILENT-NOT: {{.}}
// INVALID: error: 'tai.return' op expects parent op
// A module without an op of tai passes.
// OTHERS: func.func @f
// OPTION: no such option valid

//--- scene.mlir
tai.kernel @k() {
  tai.return
}

//--- others.mlir
func.func @f() {
  return
}
