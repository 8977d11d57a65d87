// RUN: tai-opt %s --tai-to-llvm | FileCheck %s

// A kernel with the name of a function that its code calls is not
// called.
// CHECK-LABEL: llvm.func @tan.entry(
//       CHECK:   llvm.intr.tan
tai.kernel @tan(%a: f32) -> f32 {
  %0 = math.tan %a : f32
  tai.return %0 : f32
}

// Any other name stays.
// CHECK-LABEL: llvm.func @tangent(
tai.kernel @tangent(%a: f32) -> f32 {
  %0 = math.tan %a : f32
  tai.return %0 : f32
}
