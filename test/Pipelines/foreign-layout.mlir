// RUN: tai-opt %s --tai-to-llvm --split-input-file | FileCheck %s
// RUN: tai-opt %s --tai-to-nvvm --split-input-file | FileCheck %s

// A module that says how large its indices are keeps that, beside functions
// that stay as they are, and beside nothing of tai at all.

// CHECK: module attributes {dlti.dl_spec = #dlti.dl_spec<index = 64 : i64>
// CHECK: func.func @foreign(
// CHECK: llvm.func @double(
module attributes {dlti.dl_spec = #dlti.dl_spec<index = 64 : i64>} {
  func.func @foreign(%a: f64) -> f64 {
    return %a : f64
  }
  tai.tree @t : !tai.root<dense<[i: 16], {x: f64}>>
  tai.field @x = @t["x"] : f64, rank 1
  tai.kernel @double() {
    tai.parallel_for (%i) in @x {
      %0 = tai.load @x[%i] : f64
      %1 = arith.addf %0, %0 : f64
      tai.store %1, @x[%i] : f64
    }
    tai.return
  }
}

// -----

// CHECK: module attributes {dlti.dl_spec = #dlti.dl_spec<index = 32 : i64>, foo.bar}
// CHECK: func.func @alone(
module attributes {dlti.dl_spec = #dlti.dl_spec<index = 32 : i64>, foo.bar} {
  func.func @alone(%a: index) -> index {
    return %a : index
  }
}
