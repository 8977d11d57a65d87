// RUN: tai-opt %s --tai-make-adjoint | FileCheck %s
// RUN: tai-opt %s --tai-make-adjoint --tai-scalarize --tai-lower-struct-for --tai-lower-layout --canonicalize | FileCheck %s --check-prefix=LOWER

// Adjoints of sparse fields lie beside them, and leave activity to the primal.

tai.tree @t : !tai.root<pointer<[i: 4], dense<[i: 8], {x: f32, x_grad: f32}>>>
tai.tree @d : !tai.root<dense<[i: 32], {y: f32, y_grad: f32}>>
tai.field @x_grad = @t["x_grad"] : f32, rank 1
tai.field @y_grad = @d["y_grad"] : f32, rank 1
tai.field @x = @t["x"] : f32, rank 1, adjoint @x_grad
tai.field @y = @d["y"] : f32, rank 1, adjoint @y_grad

// CHECK-LABEL: tai.kernel @gather_grad()
//  CHECK-SAME:   attributes {{{.*}}keeps_activity
//       CHECK:   tai.parallel_for (%[[I:.+]]) in @x {
//       CHECK:     tai.atomic add %{{.+}}, @x_grad
// LOWER-LABEL: tai.kernel @gather_grad()
//       LOWER:   tai_rt.active_cells
//   LOWER-NOT:   tai_rt.activate_cell
//       LOWER:   tai.return
tai.kernel @gather() {
  %c1 = arith.constant 1 : index
  tai.parallel_for (%i) in @x {
    %next = arith.addi %i, %c1 : index
    %0 = tai.load @x[%next] : f32
    tai.store %0, @y[%i] : f32
  }
  tai.return
}

// Whether a cell is active is asked again.
// CHECK-LABEL: tai.kernel @asks_grad()
//       CHECK:   tai.is_active @x
//       CHECK:   scf.if
tai.kernel @asks() {
  tai.parallel_for (%i) in @y {
    %active = tai.is_active @x[%i] level 2
    scf.if %active {
      %0 = tai.load @y[%i] : f32
      tai.atomic add %0, @x[%i] : f32
    }
  }
  tai.return
}

// A tree whose fields are not touched may lose cells.
tai.tree @other : !tai.root<pointer<[i: 4], {z: f32}>>
tai.field @z = @other["z"] : f32, rank 1
// CHECK-LABEL: tai.kernel @clears_another_grad()
//   CHECK-NOT:   tai.deactivate
//       CHECK:   tai.return
tai.kernel @clears_another() {
  tai.parallel_for (%i) in @x {
    %0 = tai.load @x[%i] : f32
    tai.store %0, @y[%i] : f32
    tai.deactivate @z[%i] level 1
  }
  tai.return
}
