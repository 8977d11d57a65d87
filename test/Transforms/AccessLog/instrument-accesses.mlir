// RUN: tai-opt %s --tai-instrument-accesses --split-input-file --verify-diagnostics | FileCheck %s

!t = !tai.root<dense<[i: 8], {x: f32, x_grad: f32, y: f32, y_grad: f32, plain: f32}>, dense<[i: 4], {v: vector<3xf32>, v_grad: vector<3xf32>}>>
tai.tree @t : !t
tai.field @x_grad = @t["x_grad"] : f32, rank 1
tai.field @y_grad = @t["y_grad"] : f32, rank 1
tai.field @v_grad = @t["v_grad"] : vector<3xf32>, rank 1
tai.field @x = @t["x"] : f32, rank 1, adjoint @x_grad
tai.field @y = @t["y"] : f32, rank 1, adjoint @y_grad
tai.field @v = @t["v"] : vector<3xf32>, rank 1, adjoint @v_grad
tai.field @plain = @t["plain"] : f32, rank 1

// A read leaves its number, and is reported if another iteration of the loop has
// written the element. A store looks for readers and writers before it.
// CHECK-LABEL: tai.kernel @move(
//  CHECK-SAME:      %[[A:.+]]: i32, %[[X:.+]]: memref<?xi32>, %[[Y:.+]]: memref<?xi32>, %[[V:.+]]: memref<?xi32>, %[[LOG:.+]]: memref<?xi64>, %[[BASE:.+]]: i32)
//  CHECK-SAME:      checked_accesses = {{\[}}[@x, 0 : i32, #{{.+}}], [@y, 1 : i32, #{{.+}}]]
//       CHECK:   tai.parallel_for (%[[I:.+]]) in @x
//       CHECK:     %[[ID:.+]] = arith.addi %[[BASE]], %{{.+}} : i32
//       CHECK:     %[[FITS:.+]] = arith.cmpi ult, %[[I]], %{{.+}} : index
//       CHECK:     scf.if %[[FITS]]
//       CHECK:       memref.atomic_rmw addi %{{.+}}, %[[LOG]]
//       CHECK:       memref.atomic_rmw assign %[[ID]], %[[X]]
//       CHECK:     %[[L:.+]] = tai.load @x[%[[I]]] : f32
//       CHECK:     memref.load %[[Y]]
//       CHECK:     memref.atomic_rmw assign %{{.+}}, %[[Y]]
//       CHECK:     tai.store %[[L]], @y[%[[I]]] : f32
tai.kernel @move(%a: i32) {
  tai.parallel_for (%i) in @x {
    %0 = tai.load @x[%i] : f32
    tai.store %0, @y[%i] : f32
  }
  tai.return
}

// Each component of a vector has words of its own. A field without an adjoint
// has none.
// CHECK-LABEL: tai.kernel @vectors(
//       CHECK:   tai.parallel_for
//       CHECK:     scf.for
//       CHECK:       memref.atomic_rmw assign
//       CHECK:     tai.load @v
//   CHECK-NOT:     memref.
//       CHECK:     tai.store %{{.+}}, @plain
tai.kernel @vectors() {
  %c0 = arith.constant 0 : index
  tai.parallel_for (%i) in @v {
    %0 = tai.load @v[%i] : vector<3xf32>
    %1 = vector.extract %0[0] : f32 from vector<3xf32>
    tai.store %1, @plain[%i] : f32
  }
  tai.return
}

// -----

// Once is enough.
// expected-error @+1 {{the accesses of this kernel are checked already}}
tai.kernel @checked() attributes {checked_accesses = []} {
  tai.return
}

// -----

// A kernel that launches it would have to pass the new arguments.
tai.kernel @launched() {
  tai.return
}
func.func @host() {
  // expected-error @+1 {{'tai.launch' op of a kernel that would take more arguments then; instruments modules without host programs}}
  tai.launch @launched() : () -> ()
  return
}
