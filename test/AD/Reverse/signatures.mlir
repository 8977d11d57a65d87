// RUN: tai-opt %s --tai-make-adjoint | FileCheck %s
// RUN: tai-opt %s --tai-make-adjoint --tai-make-adjoint | FileCheck %s
// RUN: tai-opt %s --tai-make-adjoint=array-adjoints=false | FileCheck %s

// An argument that nothing depends on has an adjoint that stays as it is.
// CHECK-LABEL: func.func @unused_input_grad(
//  CHECK-SAME:     %[[X:.+]]: f64, %{{.+}}: memref<f64>, %{{.+}}: f64, %[[DX:.+]]: memref<f64>, %{{.+}}: memref<f64>, %[[DZ:[a-z0-9]+]]: memref<f64>)
//       CHECK:   memref.store %{{.+}}, %[[DX]]
//   CHECK-NOT:   %[[DZ]]
//       CHECK:   return
func.func @unused_input(%x: f64, %y: memref<f64>, %z: f64) attributes {tai.differentiate, tai.gradients = array<i64: 0, 1, 2>} {
  %0 = arith.mulf %x, %x : f64
  memref.store %0, %y[] : memref<f64>
  return
}

// An array that is not named is constant; an array that is only written has its
// adjoint zeroed.
// CHECK-LABEL: func.func @selected_grad(
//  CHECK-SAME:     %{{.+}}: memref<f64>, %{{.+}}: memref<f64>, %[[Z:.+]]: memref<f64>, %[[DX:.+]]: memref<f64>, %[[DY:.+]]: memref<f64>)
//   CHECK-DAG:   memref.load %[[Z]]
//   CHECK-DAG:   memref.load %[[DY]]
//       CHECK:   memref.store %{{.+}}, %[[DX]]
// CHECK-LABEL: func.func @only_written_grad(
//       CHECK:   return
func.func @selected(%x: memref<f64>, %y: memref<f64>, %z: memref<f64>) attributes {tai.differentiate, tai.gradients = array<i64: 0, 1>} {
  %0 = memref.load %x[] : memref<f64>
  %1 = memref.load %z[] : memref<f64>
  %2 = arith.mulf %0, %1 : f64
  memref.store %2, %y[] : memref<f64>
  return
}
func.func @only_written(%x: memref<f64>) attributes {tai.differentiate} {
  %0 = arith.constant 1.0 : f64
  memref.store %0, %x[] : memref<f64>
  return
}

// Integers of an array may be combined in any way.
// CHECK-LABEL: func.func @max_of_array_grad(
//   CHECK-NOT:   maxs
//       CHECK:   return
func.func @max_of_array(%x: memref<4xf64>, %y: memref<4xf64>, %n: memref<4xi32>) attributes {tai.differentiate} {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  %k = arith.constant 1 : i32
  %0 = memref.load %x[%c0] : memref<4xf64>
  memref.store %0, %y[%c0] : memref<4xf64>
  memref.atomic_rmw maxs %k, %n[%c0] : (i32, memref<4xi32>) -> i32
  return
}

// Nor has an integer field a derivative, whatever adjoint it names. A declared
// adjoint of the same type is made.
// CHECK-LABEL: tai.kernel @integer_adjoint_grad(
//   CHECK-NOT:   @gi
//       CHECK:   tai.return
// CHECK-LABEL: func.func @f_grad(
//       CHECK:   memref.load
// CHECK-NOT: @f_grad_grad
!t = !tai.root<dense<[i: 16], {x: f64, gx: f64, y: f64, gy: f64, z: f64, gz: f64, n: i32, ni: i32, gi: i32}>, dense<[i: 8, j: 8], {s: f64, gs: f64}>, bitmasked<[i: 16], {h: f64, gh: f64}>, dense<[i: 8], {v: vector<2xf64>, gv: vector<2xf64>}>>
tai.tree @t : !t
tai.field @gx = @t["gx"] : f64, rank 1
tai.field @gy = @t["gy"] : f64, rank 1
tai.field @gz = @t["gz"] : f64, rank 1
tai.field @gs = @t["gs"] : f64, rank 2
tai.field @gh = @t["gh"] : f64, rank 1
tai.field @gi = @t["gi"] : i32, rank 1
tai.field @gv = @t["gv"] : vector<2xf64>, rank 1
tai.field @x = @t["x"] : f64, rank 1, adjoint @gx
tai.field @y = @t["y"] : f64, rank 1, adjoint @gy
tai.field @z = @t["z"] : f64, rank 1, adjoint @gz
tai.field @s = @t["s"] : f64, rank 2, adjoint @gs
tai.field @h = @t["h"] : f64, rank 1, adjoint @gh
tai.field @ni = @t["ni"] : i32, rank 1, adjoint @gi
tai.field @v = @t["v"] : vector<2xf64>, rank 1, adjoint @gv
tai.field @n = @t["n"] : i32, rank 1
tai.kernel @integer_adjoint() {
  tai.parallel_for (%i) in @ni {
    %0 = tai.load @ni[%i] : i32
    %1 = tai.load @x[%i] : f64
    tai.store %0, @ni[%i] : i32
    tai.store %1, @y[%i] : f64
  }
  tai.return
}
func.func private @f_grad(%x: memref<f64>, %y: memref<f64>, %dx: memref<f64>, %dy: memref<f64>)
func.func @f(%x: memref<f64>, %y: memref<f64>) attributes {tai.differentiate} {
  %0 = memref.load %x[] : memref<f64>
  memref.store %0, %y[] : memref<f64>
  return
}
