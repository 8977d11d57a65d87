// RUN: tai-opt %s --inline | FileCheck %s

// The body of a kernel has one block: a function of several is not inlined.
// CHECK-LABEL: tai.kernel @calls(
//       CHECK:   call @jumps(
// CHECK-LABEL: tai.kernel @plain(
//   CHECK-NOT:   call
//       CHECK:   arith.negf
func.func private @jumps(%x: f32, %c: i1) -> f32 {
  cf.cond_br %c, ^less, ^more
^less:
  %0 = arith.negf %x : f32
  return %0 : f32
^more:
  return %x : f32
}
func.func private @helper(%x: f32) -> f32 {
  %0 = arith.negf %x : f32
  return %0 : f32
}
tai.kernel @calls(%x: f32, %c: i1) -> f32 {
  %0 = func.call @jumps(%x, %c) : (f32, i1) -> f32
  tai.return %0 : f32
}
tai.kernel @plain(%x: f32) -> f32 {
  %0 = func.call @helper(%x) : (f32) -> f32
  tai.return %0 : f32
}
