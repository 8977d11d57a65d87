// REQUIRES: plugin
// A stock mlir-opt reads checks under both names, in both forms.
//
// RUN: mlir-opt-22 %s --load-dialect-plugin=%tai_plugin | FileCheck %s
// RUN: mlir-opt-22 %s --load-dialect-plugin=%tai_plugin --canonicalize | FileCheck %s --check-prefix=NEW
// RUN: mlir-opt-22 %s --load-dialect-plugin=%tai_plugin --load-pass-plugin=%tai_plugin \
// RUN:   --pass-pipeline='builtin.module(tai-to-llvm)' | FileCheck %s --check-prefix=CODE

// CHECK-LABEL: func.func @main
//  CHECK-NEXT:   tai_check.close %arg0, %arg1 tolerance
//  CHECK-NEXT:   tai_check.close %arg1, %arg0 tolerance
//  CHECK-NEXT:   tai.check_close %arg0, %arg0 tolerance
//  CHECK-NEXT:   tai_check.close %arg1, %arg1 tolerance
// NEW-COUNT-4: tai_check.close
//     NEW-NOT: tai.check_close
// CODE-COUNT-4: llvm.call @tai_rt_fail(
//     CODE-NOT: check_close
func.func @main(%a: f32, %b: f32) {
  tai_check.close %a, %b tolerance 1.0e-6 : f32
  tai.check_close %b, %a tolerance 1.0e-6 : f32
  "tai.check_close"(%a, %a) <{tolerance = 1.0e-6 : f64}> : (f32, f32) -> ()
  "tai_check.close"(%b, %b) <{tolerance = 1.0e-6 : f64}> : (f32, f32) -> ()
  return
}
