// RUN: tai-run %s | FileCheck %s

// Three springs and three mass points. The rest lengths are optimised by
// gradient descent so that the triangle has the wanted area at the end: the
// program of section 3 of the DiffTaichi paper, whose printed result belongs to
// a target area of 0.1. Written with the former names of checks, as
// programs outside of this tree are.

tai.tree @state : !tai.root<
    dense<[i: 1024, j: 3], {x: vector<2xf64>, v: vector<2xf64>, f: vector<2xf64>}>,
    dense<[i: 1024, j: 3], {x_grad: vector<2xf64>, v_grad: vector<2xf64>,
                            f_grad: vector<2xf64>}>>
tai.tree @springs : !tai.root<
    dense<[i: 3], {a: i32, b: i32, rest: f64, rest_grad: f64}>,
    {loss: f64, loss_grad: f64}>

tai.field @x_grad = @state["x_grad"] : vector<2xf64>, rank 2
tai.field @v_grad = @state["v_grad"] : vector<2xf64>, rank 2
tai.field @force_grad = @state["f_grad"] : vector<2xf64>, rank 2
tai.field @x = @state["x"] : vector<2xf64>, rank 2, adjoint @x_grad
tai.field @v = @state["v"] : vector<2xf64>, rank 2, adjoint @v_grad
tai.field @force = @state["f"] : vector<2xf64>, rank 2, adjoint @force_grad
tai.field @anchor_a = @springs["a"] : i32, rank 1
tai.field @anchor_b = @springs["b"] : i32, rank 1
tai.field @rest_grad = @springs["rest_grad"] : f64, rank 1
tai.field @rest = @springs["rest"] : f64, rank 1, adjoint @rest_grad
tai.field @loss_grad = @springs["loss_grad"] : f64, rank 0
tai.field @loss = @springs["loss"] : f64, rank 0, adjoint @loss_grad

tai.kernel @apply_spring_force(%t: i32) {
  %stiffness = arith.constant 10.0 : f64
  %epsilon = arith.constant 1.0e-4 : f64
  %c1 = arith.constant 1 : index
  %now = arith.index_cast %t : i32 to index
  %before = arith.subi %now, %c1 : index
  tai.parallel_for (%s) in @rest {
    %a32 = tai.load @anchor_a[%s] : i32
    %b32 = tai.load @anchor_b[%s] : i32
    %a = arith.index_cast %a32 : i32 to index
    %b = arith.index_cast %b32 : i32 to index
    %xa = tai.load @x[%before, %a] : vector<2xf64>
    %xb = tai.load @x[%before, %b] : vector<2xf64>
    %dist = arith.subf %xa, %xb : vector<2xf64>
    %norm = tai.norm %dist : vector<2xf64>
    %length = arith.addf %norm, %epsilon : f64
    %rest = tai.load @rest[%s] : f64
    %stretch = arith.subf %length, %rest : f64
    %pull = arith.mulf %stretch, %stiffness : f64
    %factor = arith.divf %pull, %length : f64
    %factors = vector.broadcast %factor : f64 to vector<2xf64>
    %f = arith.mulf %factors, %dist : vector<2xf64>
    %minus = arith.negf %f : vector<2xf64>
    %0 = tai.atomic add %minus, @force[%now, %a] : vector<2xf64>
    %1 = tai.atomic add %f, @force[%now, %b] : vector<2xf64>
  }
  tai.return
}

tai.kernel @time_integrate(%t: i32) {
  %dt = arith.constant dense<1.0e-3> : vector<2xf64>
  // exp(-dt * damping), damping 20
  %decay = arith.constant dense<0.98019867330675525> : vector<2xf64>
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  %c3 = arith.constant 3 : index
  %now = arith.index_cast %t : i32 to index
  %before = arith.subi %now, %c1 : index
  tai.parallel_for (%i) = (%c0) to (%c3) {
    %v0 = tai.load @v[%before, %i] : vector<2xf64>
    %f = tai.load @force[%now, %i] : vector<2xf64>
    %slow = arith.mulf %decay, %v0 : vector<2xf64>
    %kick = arith.mulf %dt, %f : vector<2xf64>
    %v1 = arith.addf %slow, %kick : vector<2xf64>
    tai.store %v1, @v[%now, %i] : vector<2xf64>
    %x0 = tai.load @x[%before, %i] : vector<2xf64>
    %step = arith.mulf %dt, %v1 : vector<2xf64>
    %x1 = arith.addf %x0, %step : vector<2xf64>
    tai.store %x1, @x[%now, %i] : vector<2xf64>
  }
  tai.return
}

tai.kernel @compute_loss(%t: i32) {
  %half = arith.constant 0.5 : f64
  %target = arith.constant 0.1 : f64
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  %c2 = arith.constant 2 : index
  %now = arith.index_cast %t : i32 to index
  %x0 = tai.load @x[%now, %c0] : vector<2xf64>
  %x1 = tai.load @x[%now, %c1] : vector<2xf64>
  %x2 = tai.load @x[%now, %c2] : vector<2xf64>
  %x01 = arith.subf %x0, %x1 : vector<2xf64>
  %x02 = arith.subf %x0, %x2 : vector<2xf64>
  %ax = vector.extract %x01[0] : f64 from vector<2xf64>
  %ay = vector.extract %x01[1] : f64 from vector<2xf64>
  %bx = vector.extract %x02[0] : f64 from vector<2xf64>
  %by = vector.extract %x02[1] : f64 from vector<2xf64>
  %p = arith.mulf %ax, %by : f64
  %q = arith.mulf %ay, %bx : f64
  %cross = arith.subf %p, %q : f64
  %signed = arith.mulf %cross, %half : f64
  %area = math.absf %signed : f64
  %miss = arith.subf %area, %target : f64
  %loss = arith.mulf %miss, %miss : f64
  tai.store %loss, @loss[] : f64
  tai.return
}

tai.kernel @clear_forces() {
  %zero = arith.constant dense<0.0> : vector<2xf64>
  tai.parallel_for (%t, %i) in @force {
    tai.store %zero, @force[%t, %i] : vector<2xf64>
  }
  tai.return
}

tai.kernel @descend() {
  %rate = arith.constant 5.0 : f64
  tai.parallel_for (%s) in @rest {
    %g = tai.load @rest_grad[%s] : f64
    %l = tai.load @rest[%s] : f64
    %step = arith.mulf %rate, %g : f64
    %new = arith.subf %l, %step : f64
    tai.store %new, @rest[%s] : f64
  }
  tai.return
}

func.func @set_up() {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  %c2 = arith.constant 2 : index
  %i0 = arith.constant 0 : i32
  %i1 = arith.constant 1 : i32
  %i2 = arith.constant 2 : i32
  %p0 = arith.constant dense<[0.3, 0.5]> : vector<2xf64>
  %p1 = arith.constant dense<[0.3, 0.4]> : vector<2xf64>
  %p2 = arith.constant dense<[0.4, 0.4]> : vector<2xf64>
  tai.store %p0, @x[%c0, %c0] : vector<2xf64>
  tai.store %p1, @x[%c0, %c1] : vector<2xf64>
  tai.store %p2, @x[%c0, %c2] : vector<2xf64>
  tai.store %i0, @anchor_a[%c0] : i32
  tai.store %i1, @anchor_b[%c0] : i32
  tai.store %i1, @anchor_a[%c1] : i32
  tai.store %i2, @anchor_b[%c1] : i32
  tai.store %i2, @anchor_a[%c2] : i32
  tai.store %i0, @anchor_b[%c2] : i32
  %side = arith.constant 0.1 : f64
  %diagonal = arith.constant 0.14142135623730953 : f64
  tai.store %side, @rest[%c0] : f64
  tai.store %side, @rest[%c1] : f64
  tai.store %diagonal, @rest[%c2] : f64
  return
}

func.func @forward(%steps: i32) {
  %i1 = arith.constant 1 : i32
  scf.for %t = %i1 to %steps step %i1 : i32 {
    tai.launch @apply_spring_force(%t) : (i32) -> ()
    tai.launch @time_integrate(%t) : (i32) -> ()
  }
  %last = arith.subi %steps, %i1 : i32
  tai.launch @compute_loss(%last) : (i32) -> ()
  return
}

func.func @main() {
  func.call @set_up() : () -> ()

  // A short rollout: the gradient agrees with central differences.
  %short = arith.constant 40 : i32
  tai.check_gradient loss(@loss) wrt [@rest] tolerance 1.0e-7 {
    tai.launch @clear_forces() : () -> ()
    func.call @forward(%short) : (i32) -> ()
  }

  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  %c2 = arith.constant 2 : index
  %iterations = arith.constant 25 : index
  %steps = arith.constant 1024 : i32
  scf.for %n = %c0 to %iterations step %c1 {
    tai.launch @clear_forces() : () -> ()
    tai.tape loss(@loss) {
      func.call @forward(%steps) : (i32) -> ()
    }
    tai.launch @descend() : () -> ()
    %loss = tai.load @loss[] : f64
    tai.print "loss {}"(%loss) : f64
  }

  // The result that the paper prints, to its three decimals.
  %paper = arith.constant 0.600 : f64
  %paper2 = arith.constant 0.529 : f64
  %r0 = tai.load @rest[%c0] : f64
  %r1 = tai.load @rest[%c1] : f64
  %r2 = tai.load @rest[%c2] : f64
  tai.check_close %r0, %paper tolerance 5.0e-4 : f64
  tai.check_close %r1, %paper tolerance 5.0e-4 : f64
  tai.check_close %r2, %paper2 tolerance 5.0e-4 : f64
  return
}

// Losses of an independent transcription in NumPy.
// CHECK:      loss 0.0090264019800398
// CHECK-NEXT: loss 0.008643
// CHECK-NEXT: loss 0.0081431
// CHECK-NEXT: loss 0.007507
