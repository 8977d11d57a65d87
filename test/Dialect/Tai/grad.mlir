// RUN: tai-opt %s --verify-roundtrip | FileCheck %s

func.func @f(%x: f64, %m: memref<?xvector<3xf64>>, %n: i32) -> (f64, f64) {
  return %x, %x : f64, f64
}

// CHECK-LABEL: func.func @uses(
func.func @uses(%x: f64, %m: memref<?xvector<3xf64>>, %n: i32, %g: memref<?x3xf64>) {
  // CHECK: tai.grad @f(%{{.*}}, %{{.*}}, %{{.*}}, %{{.*}}, %{{.*}}, %{{.*}}) : (
  %0 = tai.grad @f(%x, %m, %n, %g, %x, %x)
      : (f64, memref<?xvector<3xf64>>, i32, memref<?x3xf64>, f64, f64) -> f64
  // CHECK: tai.grad @f(%{{.*}}, %{{.*}}, %{{.*}}, %{{.*}}) wrt [0] of [1] {a = 1 : i32} : (
  %1 = tai.grad @f(%x, %m, %n, %x) wrt [0] of [1] {a = 1 : i32}
      : (f64, memref<?xvector<3xf64>>, i32, f64) -> f64
  // CHECK: tai.grad @f(%{{.*}}, %{{.*}}, %{{.*}}, %{{.*}}) wrt [1] of [] : (
  tai.grad @f(%x, %m, %n, %g) wrt [1] of []
      : (f64, memref<?xvector<3xf64>>, i32, memref<?x3xf64>) -> ()
  return
}
