// RUN: tai-opt %s --tai-make-adjoint=stored-outputs --canonicalize --cse | FileCheck %s
// RUN: tai-opt %s --tai-make-adjoint="stored-outputs zero-overwritten" --canonicalize --cse | FileCheck %s --check-prefix=TAKES
// RUN: tai-opt %s --tai-make-adjoint --canonicalize --cse | FileCheck %s --check-prefix=OFF

// The form of adjoints that loads what kernels have stored.

// OFF-NOT: stored_form

!t = !tai.root<dense<[i: 16], dense<[j: 16], {y: f32, y_grad: f32, v: vector<2xf32>, v_grad: vector<2xf32>}>>, dense<[i: 16], {x: f32, x_grad: f32, z: f32, low: f16}>, pointer<[i: 4], dense<[i: 4], {s: f32, s_grad: f32}>>>
tai.tree @t : !t
tai.field @x_grad = @t["x_grad"] : f32, rank 1
tai.field @y_grad = @t["y_grad"] : f32, rank 2
tai.field @v_grad = @t["v_grad"] : vector<2xf32>, rank 2
tai.field @s_grad = @t["s_grad"] : f32, rank 1
tai.field @x = @t["x"] : f32, rank 1, adjoint @x_grad
tai.field @y = @t["y"] : f32, rank 2, adjoint @y_grad
tai.field @v = @t["v"] : vector<2xf32>, rank 2, adjoint @v_grad
tai.field @s = @t["s"] : f32, rank 1, adjoint @s_grad
tai.field @z = @t["z"] : f32, rank 1
tai.field @low = @t["low"] : f16, rank 1

// CHECK-LABEL: tai.kernel @layer_grad(
// CHECK-SAME:    attributes {stored_form = @layer_grad_stored}
//      CHECK:    math.sin
//      CHECK:    math.tanh
// CHECK-LABEL: tai.kernel @layer_grad_stored(%arg0: i32) {
//      CHECK:    tai.parallel_for (%[[I:.+]]) in @x {
// CHECK-NEXT:      %[[T:.+]] = arith.index_cast %arg0
// CHECK-NEXT:      %[[R:.+]] = tai.load @y[%[[T]], %[[I]]]
// CHECK-NEXT:      %[[X:.+]] = tai.load @x[%[[I]]]
// CHECK-NEXT:      %[[G:.+]] = tai.load @y_grad[%[[T]], %[[I]]]
// CHECK-NEXT:      %[[A:.+]] = arith.subf %{{.+}}, %[[R]]
// CHECK-NEXT:      %[[B:.+]] = arith.addf %[[R]], %{{.+}}
// CHECK-NEXT:      %[[P:.+]] = arith.mulf %[[A]], %[[B]]
// CHECK-NEXT:      %[[S:.+]] = arith.mulf %[[G]], %[[P]]
// CHECK-NEXT:      %[[COS:.+]] = math.cos %[[X]]
// CHECK-NEXT:      %[[GX:.+]] = arith.mulf %[[S]], %[[COS]]
// CHECK-NEXT:      tai.atomic add %[[GX]], @x_grad[%[[I]]] exclusive
//
// Both forms take.
// TAKES-LABEL: tai.kernel @layer_grad(
// TAKES-SAME:    stored_form = @layer_grad_stored, zeroes_adjoint
// TAKES-LABEL: tai.kernel @layer_grad_stored(
// TAKES-SAME:    attributes {zeroes_adjoint}
//      TAKES:    tai.load @y[
//      TAKES:    tai.store %{{.+}}, @y_grad[
tai.kernel @layer(%t: i32) {
  tai.parallel_for (%i) in @x {
    %0 = tai.load @x[%i] : f32
    %1 = math.sin %0 : f32
    %2 = math.tanh %1 : f32
    // After the value: the adjoint computes it before.
    %slot = arith.index_cast %t : i32 to index
    tai.store %2, @y[%slot, %i] : f32
  }
  tai.return
}

// A component of a stored value.
// CHECK-LABEL: tai.kernel @component_grad_stored(
//      CHECK:    tai.parallel_for (%[[I:.+]]) in @x {
//  CHECK-NOT:      math.exp
//      CHECK:      tai.load @v[%arg0, %[[I]]] component[%c1] : f32
//  CHECK-NOT:      math.exp
//      CHECK:    tai.return
tai.kernel @component(%t: index) {
  tai.parallel_for (%i) in @x {
    %0 = tai.load @x[%i] : f32
    %1 = math.exp %0 : f32
    %2 = vector.from_elements %0, %1 : vector<2xf32>
    tai.store %2, @v[%t, %i] : vector<2xf32>
  }
  tai.return
}

// In a serial loop, each iteration loads its own.
// CHECK-LABEL: tai.kernel @serial_grad_stored(
//      CHECK:    scf.for
//  CHECK-NOT:      math.exp
//      CHECK:      tai.load @y[
//  CHECK-NOT:      math.exp
//      CHECK:    tai.return
tai.kernel @serial() {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  %c16 = arith.constant 16 : index
  tai.parallel_for (%i) in @x {
    scf.for %k = %c0 to %c16 step %c1 {
      %0 = tai.load @x[%i] : f32
      %1 = math.exp %0 : f32
      tai.store %1, @y[%k, %i] : f32
    }
  }
  tai.return
}

// The last iteration stores over all others.
// CHECK-LABEL: tai.kernel @repeated_grad(
//  CHECK-NOT:  @repeated_grad_stored
tai.kernel @repeated() {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  %c16 = arith.constant 16 : index
  tai.parallel_for (%i) in @x {
    scf.for %k = %c0 to %c16 step %c1 {
      %0 = tai.load @x[%i] : f32
      %1 = math.exp %0 : f32
      tai.store %1, @y[%c0, %i] : f32
    }
  }
  tai.return
}

// Several iterations store to one element.
// CHECK-LABEL: tai.kernel @shared_grad(
//  CHECK-NOT:  @shared_grad_stored
tai.kernel @shared(%t: index) {
  tai.parallel_for (%i) in @x {
    %0 = tai.load @x[%i] : f32
    %1 = math.exp %0 : f32
    tai.store %1, @y[%t, %t] : f32
  }
  tai.return
}

// So they may where the index is read from a field.
// CHECK-LABEL: tai.kernel @rounded_index_grad(
//  CHECK-NOT:  @rounded_index_grad_stored
tai.kernel @rounded_index() {
  %c2 = arith.constant 2 : index
  tai.parallel_for (%i) in @x {
    %0 = tai.load @x[%i] : f32
    %1 = math.exp %0 : f32
    %half = arith.divui %i, %c2 : index
    tai.store %1, @y[%half, %half] : f32
  }
  tai.return
}

// A later loop changes it.
// CHECK-LABEL: tai.kernel @changed_grad(
//  CHECK-NOT:  @changed_grad_stored
tai.kernel @changed(%t: index) {
  %zero = arith.constant 0.0 : f32
  tai.parallel_for (%i) in @x {
    %0 = tai.load @x[%i] : f32
    %1 = math.exp %0 : f32
    tai.store %1, @z[%i] : f32
    tai.store %1, @y[%t, %i] : f32
  }
  tai.parallel_for (%i) in @x {
    tai.store %zero, @z[%i] : f32
    tai.store %zero, @y[%t, %i] : f32
  }
  tai.return
}

// An update of another iteration may.
// CHECK-LABEL: tai.kernel @updated_grad(
//  CHECK-NOT:  @updated_grad_stored
tai.kernel @updated() {
  %c1 = arith.constant 1 : index
  %one = arith.constant 1.0 : f32
  tai.parallel_for (%i) in @x {
    %0 = tai.load @x[%i] : f32
    %1 = math.exp %0 : f32
    tai.store %1, @y[%i, %i] : f32
    %next = arith.addi %i, %c1 : index
    tai.atomic add %one, @y[%next, %next] : f32
  }
  tai.return
}

// Stored for some iterations only.
// CHECK-LABEL: tai.kernel @sometimes_grad(
//  CHECK-NOT:  @sometimes_grad_stored
tai.kernel @sometimes(%t: index, %n: index) {
  tai.parallel_for (%i) in @x {
    %0 = tai.load @x[%i] : f32
    %1 = math.exp %0 : f32
    %small = arith.cmpi slt, %i, %n : index
    scf.if %small {
      tai.store %1, @z[%i] : f32
    }
    tai.store %1, @y[%t, %t] : f32
  }
  tai.return
}

// The stored value was rounded.
// CHECK-LABEL: tai.kernel @rounded_grad(
//  CHECK-NOT:  @rounded_grad_stored
tai.kernel @rounded(%t: index) {
  tai.parallel_for (%i) in @x {
    %0 = tai.load @x[%i] : f32
    %1 = math.exp %0 : f32
    %2 = arith.truncf %1 : f32 to f16
    tai.store %2, @low[%i] : f16
    tai.store %1, @y[%t, %t] : f32
  }
  tai.return
}

// Little to gain.
// CHECK-LABEL: tai.kernel @cheap_grad(
//  CHECK-NOT:  @cheap_grad_stored
tai.kernel @cheap(%t: index) {
  tai.parallel_for (%i) in @x {
    %0 = tai.load @x[%i] : f32
    %1 = math.sqrt %0 : f32
    tai.store %1, @y[%t, %i] : f32
  }
  tai.return
}

// The former value is needed too, and only one of both is there.
// CHECK-LABEL: tai.kernel @in_place_grad(
// CHECK-SAME:    {guarded, reads_before = [@x]}
//  CHECK-NOT:  @in_place_grad_stored
tai.kernel @in_place() {
  tai.parallel_for (%i) in @x {
    %0 = tai.load @x[%i] : f32
    %1 = arith.mulf %0, %0 : f32
    %2 = math.exp %1 : f32
    tai.store %2, @x[%i] : f32
  }
  tai.return
}

// Cells that come and go.
// CHECK-LABEL: tai.kernel @sparse_grad(
//  CHECK-NOT:  @sparse_grad_stored
tai.kernel @sparse() {
  tai.parallel_for (%i) in @x {
    %0 = tai.load @x[%i] : f32
    %1 = math.exp %0 : f32
    tai.store %1, @s[%i] : f32
  }
  tai.return
}

// Where the adjoint goes must be computed the same way in both of its forms.
// CHECK-LABEL: tai.kernel @condition_grad(
//  CHECK-NOT:  @condition_grad_stored
tai.kernel @condition(%t: index) {
  %half = arith.constant 0.5 : f32
  tai.parallel_for (%i) in @x {
    %0 = tai.load @x[%i] : f32
    %1 = math.exp %0 : f32
    tai.store %1, @z[%i] : f32
    %large = arith.cmpf ogt, %1, %half : f32
    scf.if %large {
      tai.store %0, @y[%t, %i] : f32
    }
  }
  tai.return
}

// A name that is taken stays with who has it.
// CHECK-LABEL: tai.kernel @taken() attributes {adjoint = @taken_grad} {
// CHECK-LABEL: tai.kernel @taken_grad() attributes {guarded} {
// CHECK-LABEL: tai.kernel @taken_grad_stored() attributes {adjoint = @taken_grad_stored_grad} {
tai.kernel @taken() {
  tai.parallel_for (%i) in @x {
    %0 = tai.load @x[%i] : f32
    %1 = math.exp %0 : f32
    tai.store %1, @y[%i, %i] : f32
  }
  tai.return
}
tai.kernel @taken_grad_stored() {
  tai.return
}
