// RUN: tai-opt %s --tai-convert-to-llvm | FileCheck %s

// Functions of the library look at the bits of their operands, which are zero
// first where they are denormal. A root is an instruction, which knows the mode.
// CHECK-LABEL: llvm.func internal @functions.flushing(
//       CHECK:   %[[SIZE:.+]] = llvm.intr.fabs(%[[X:.+]]) : (f64) -> f64
//       CHECK:   %[[SMALL:.+]] = llvm.fcmp "olt" %[[SIZE]], %{{.+}} : f64
//       CHECK:   %[[ZERO:.+]] = llvm.intr.copysign(%{{.+}}, %[[X]])
//       CHECK:   %[[FLUSHED:.+]] = llvm.select %[[SMALL]], %[[ZERO]], %[[X]]
//       CHECK:   %[[LOG:.+]] = llvm.intr.log(%[[FLUSHED]])
//       CHECK:   llvm.select
//       CHECK:   llvm.call @cbrt(
//   CHECK-NOT:   llvm.select
//       CHECK:   llvm.intr.sqrt(
llvm.func @functions(%x: f64) -> f64 attributes {passthrough = [["tai.modes", "ftz=true"]]} {
  %0 = math.log %x : f64
  %1 = math.cbrt %0 : f64
  %2 = math.sqrt %1 : f64
  llvm.return %2 : f64
}

// CHECK-LABEL: llvm.func @kept(
//   CHECK-NOT:   llvm.select
llvm.func @kept(%x: f64) -> f64 {
  %0 = math.log %x : f64
  llvm.return %0 : f64
}
