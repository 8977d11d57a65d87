// RUN: tai-opt %s --tai-to-llvm --split-input-file | FileCheck %s
// RUN: tai-opt %s --tai-to-nvvm --split-input-file | FileCheck %s
// RUN: tai-opt %s --tai-to-llvm=opt-level=0 --split-input-file | FileCheck %s

// Functions that have nothing to do with tai stay as they are, in whatever
// dialect they are written: of several blocks, recursive, external, private,
// in modules of their own. Not even a general simplification reaches them.
// CHECK-LABEL: func.func @axpy(
//  CHECK-SAME:     %[[A:.+]]: f64, %[[B:.+]]: f64) -> f64
//  CHECK-NEXT:   %[[ONE:.+]] = arith.constant 1.0
//  CHECK-NEXT:   %[[X:.+]] = arith.mulf %[[A]], %[[ONE]]
//  CHECK-NEXT:   %[[Y:.+]] = arith.mulf %[[A]], %[[ONE]]
//  CHECK-NEXT:   %[[S:.+]] = arith.addf %[[X]], %[[Y]]
//  CHECK-NEXT:   %[[R:.+]] = call @helper(%[[S]], %[[B]])
//  CHECK-NEXT:   return %[[R]] : f64
func.func @axpy(%a: f64, %b: f64) -> f64 {
  %one = arith.constant 1.0 : f64
  %x = arith.mulf %a, %one : f64
  %y = arith.mulf %a, %one : f64
  %s = arith.addf %x, %y : f64
  %r = func.call @helper(%s, %b) : (f64, f64) -> f64
  return %r : f64
}
// Shared by both sides: the kernel gets its own.
// CHECK-LABEL: func.func private @helper(
//  CHECK-SAME:     f64, %{{.+}}: f64) -> f64
func.func private @helper(%a: f64, %b: f64) -> f64 {
  %0 = arith.addf %a, %b : f64
  return %0 : f64
}
// CHECK-LABEL: func.func @blocks(
//       CHECK:   cf.cond_br
//       CHECK: ^bb1:
func.func @blocks(%c: i1, %a: f64) -> f64 {
  cf.cond_br %c, ^one, ^two
^one:
  return %a : f64
^two:
  %0 = arith.negf %a : f64
  return %0 : f64
}
// CHECK-LABEL: func.func private @down(
//       CHECK:   call @down(
func.func private @down(%n: i64) -> i64 {
  %0 = func.call @down(%n) : (i64) -> i64
  return %0 : i64
}
// CHECK: func.func private @external(memref<?xf32>) -> vector<4xf32>
func.func private @external(memref<?xf32>) -> vector<4xf32>
// CHECK: func.func private @unused() -> (f32, i1)
func.func private @unused() -> (f32, i1)
// CHECK-LABEL: func.func @pointer()
//       CHECK:   constant @axpy : (f64, f64) -> f64
func.func @pointer() -> ((f64, f64) -> f64) {
  %0 = func.constant @axpy : (f64, f64) -> f64
  return %0 : (f64, f64) -> f64
}
// CHECK-LABEL: llvm.func @plain(
//  CHECK-SAME:     f64) -> f64
//       CHECK:   llvm.fadd
llvm.func @plain(%a: f64) -> f64 {
  %0 = llvm.fadd %a, %a : f64
  llvm.return %0 : f64
}
// CHECK-LABEL: module @inner
//       CHECK:   func.func @axpy(
module @inner {
  func.func @axpy(%a: f64) -> f64 {
    return %a : f64
  }
}

tai.tree @t : !tai.root<dense<[i: 16], {x: f64}>>
tai.field @x = @t["x"] : f64, rank 1

// CHECK-LABEL: llvm.func @double(
//  CHECK-SAME:     !llvm.ptr) -> i32
tai.kernel @double() {
  tai.parallel_for (%i) in @x {
    %0 = tai.load @x[%i] : f64
    %1 = func.call @helper(%0, %0) : (f64, f64) -> f64
    %2 = llvm.call @plain(%1) : (f64) -> f64
    tai.store %2, @x[%i] : f64
  }
  tai.return
}
// The caller of a host program is one.
// CHECK-LABEL: llvm.func @outer(
//  CHECK-SAME:     !llvm.ptr) -> i32
//       CHECK:   llvm.call @tai_rt_host_launch
func.func @outer() {
  func.call @main() : () -> ()
  return
}
func.func @main() {
  tai.launch @double() : () -> ()
  return
}

// -----

// A module without tai is left as it is.
// CHECK-LABEL: func.func @alone(
//       CHECK:   %{{.+}} = arith.addf
func.func @alone(%a: f64) -> f64 {
  %0 = arith.addf %a, %a : f64
  return %0 : f64
}
