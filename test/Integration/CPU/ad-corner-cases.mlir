// RUN: tai-run %s --no-cache

// Gradients of programs that take the rarer ways through reverse mode agree with
// central differences.

!v = vector<2xf64>
tai.tree @data : !tai.root<
    dense<[i: 8], {x: f64, x_grad: f64, y: f64, y_grad: f64, z: f64, z_grad: f64, n: i32}>,
    dense<[i: 8], {v: !v, v_grad: !v}>,
    {loss: f64, loss_grad: f64, b: f64, b_grad: f64}>
tai.field @x_grad = @data["x_grad"] : f64, rank 1
tai.field @y_grad = @data["y_grad"] : f64, rank 1
tai.field @z_grad = @data["z_grad"] : f64, rank 1
tai.field @v_grad = @data["v_grad"] : !v, rank 1
tai.field @loss_grad = @data["loss_grad"] : f64, rank 0
tai.field @x = @data["x"] : f64, rank 1, adjoint @x_grad
tai.field @y = @data["y"] : f64, rank 1, adjoint @y_grad
tai.field @z = @data["z"] : f64, rank 1, adjoint @z_grad
tai.field @v = @data["v"] : !v, rank 1, adjoint @v_grad
tai.field @b_grad = @data["b_grad"] : f64, rank 0
tai.field @b = @data["b"] : f64, rank 0, adjoint @b_grad
tai.field @n = @data["n"] : i32, rank 1
tai.field @loss = @data["loss"] : f64, rank 0, adjoint @loss_grad

tai.kernel @fill() {
  %first = arith.constant 0.31 : f64
  %scale = arith.constant 0.11 : f64
  %two = arith.constant 2 : i32
  tai.parallel_for (%i) in @x {
    %k = arith.index_cast %i : index to i32
    %f = arith.sitofp %k : i32 to f64
    %g = arith.mulf %f, %scale : f64
    %h = arith.addf %g, %first : f64
    %s = math.cos %f : f64
    %w = vector.from_elements %h, %s : !v
    tai.store %h, @x[%i] : f64
    tai.store %h, @y[%i] : f64
    tai.store %s, @z[%i] : f64
    tai.store %w, @v[%i] : !v
    tai.store %k, @n[%i] : i32
  }
  tai.return
}

// A loop that counts in the widest integers, from anywhere and by any step.
tai.kernel @wide_counter(%from: i64, %to: i64, %by: i64) {
  tai.parallel_for (%i) in @x {
    %0 = tai.load @x[%i] : f64
    %r = scf.for %k = %from to %to step %by iter_args(%a = %0) -> f64 : i64 {
      %f = arith.sitofp %k : i64 to f64
      %m = arith.mulf %a, %0 : f64
      %s = arith.addf %m, %f : f64
      scf.yield %s : f64
    }
    tai.atomic add %r, @loss[] : f64
  }
  tai.return
}

// Adjoints of vectors of which single components are used.
tai.kernel @components_only() {
  tai.parallel_for (%i) in @v {
    %w = tai.load @v[%i] : !v
    %a = vector.extract %w[0] : f64 from !v
    %b = vector.extract %w[1] : f64 from !v
    %c = vector.from_elements %b, %a : !v
    %d = vector.shape_cast %c : !v to vector<1x2xf64>
    %e = vector.extract %d[0, 0] : f64 from vector<1x2xf64>
    %f = vector.insert %e, %c [1] : f64 into !v
    %g = vector.extract %f[0] : f64 from !v
    %h = arith.mulf %g, %e : f64
    tai.atomic add %h, @loss[] : f64
  }
  tai.return
}

// Values from outside of a parallel loop: made by an op, in a loop around it, by
// a loop, from the value of another block, and by very many ops.
tai.kernel @captured(%n: index) {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  %0 = tai.load @z[%c0] : f64
  %s = math.sin %0 : f64
  %r = scf.for %k = %c0 to %n step %c1 iter_args(%a = %0) -> f64 {
    %m = arith.mulf %a, %0 : f64
    scf.yield %m : f64
  }
  tai.parallel_for (%i) in @x {
    %1 = tai.load @x[%i] : f64
    %2 = arith.mulf %1, %s : f64
    %3 = arith.mulf %2, %r : f64
    tai.atomic add %3, @loss[] : f64
  }
  scf.for %k = %c0 to %n step %c1 {
    %t = math.sin %0 : f64
    tai.parallel_for (%i) in @x {
      %1 = tai.load @x[%i] : f64
      %2 = arith.mulf %1, %t : f64
      tai.atomic add %2, @loss[] : f64
    }
  }
  tai.return
}
tai.kernel @captured_after_many() {
  %c0 = arith.constant 0 : index
  %half = arith.constant 0.5 : f64
  %0 = tai.load @z[%c0] : f64
  %m0 = math.sin %0 : f64
  %m1 = math.sin %m0 : f64
  %m2 = arith.addf %m1, %half : f64
  %m3 = math.sin %m2 : f64
  %m4 = arith.addf %m3, %half : f64
  %m5 = math.sin %m4 : f64
  %m6 = arith.addf %m5, %half : f64
  %m7 = math.sin %m6 : f64
  %m8 = arith.addf %m7, %half : f64
  %m9 = math.sin %m8 : f64
  %m10 = arith.addf %m9, %half : f64
  %m11 = math.sin %m10 : f64
  %m12 = arith.addf %m11, %half : f64
  %m13 = math.sin %m12 : f64
  %m14 = arith.addf %m13, %half : f64
  %m15 = math.sin %m14 : f64
  %m16 = arith.addf %m15, %half : f64
  %m17 = math.sin %m16 : f64
  %m18 = arith.addf %m17, %half : f64
  %m19 = math.sin %m18 : f64
  %m20 = arith.addf %m19, %half : f64
  %m21 = math.sin %m20 : f64
  %m22 = arith.addf %m21, %half : f64
  %m23 = math.sin %m22 : f64
  %m24 = arith.addf %m23, %half : f64
  %m25 = math.sin %m24 : f64
  %m26 = arith.addf %m25, %half : f64
  %m27 = math.sin %m26 : f64
  %m28 = arith.addf %m27, %half : f64
  %m29 = math.sin %m28 : f64
  %m30 = arith.addf %m29, %half : f64
  %m31 = math.sin %m30 : f64
  %m32 = arith.addf %m31, %half : f64
  %m33 = math.sin %m32 : f64
  %m34 = arith.addf %m33, %half : f64
  %m35 = math.sin %m34 : f64
  %m36 = arith.addf %m35, %half : f64
  %m37 = math.sin %m36 : f64
  %m38 = arith.addf %m37, %half : f64
  %m39 = math.sin %m38 : f64
  %m40 = arith.addf %m39, %half : f64
  tai.parallel_for (%i) in @x {
    %a = tai.load @x[%i] : f64
    %b = arith.mulf %a, %m40 : f64
    tai.atomic add %b, @loss[] : f64
  }
  tai.return
}

// An element that is stored and read again by an index from a field, after a
// branch whose result is stored.
tai.kernel @rerun(%c: i1) {
  tai.parallel_for (%i) in @y {
    %0 = tai.load @y[%i] : f64
    %r = scf.if %c -> f64 {
      %1 = math.sin %0 : f64
      %2 = math.exp %1 : f64
      scf.yield %2 : f64
    } else {
      scf.yield %0 : f64
    }
    tai.store %r, @y[%i] : f64
    %k = tai.load @n[%i] : i32
    %j = arith.index_cast %k : i32 to index
    %3 = tai.load @y[%j] : f64
    %4 = arith.mulf %3, %r : f64
    tai.store %4, @y[%i] : f64
  }
  tai.return
}
tai.kernel @copy() {
  tai.parallel_for (%i) in @y {
    %0 = tai.load @x[%i] : f64
    tai.store %0, @y[%i] : f64
  }
  tai.return
}
tai.kernel @sum() {
  tai.parallel_for (%i) in @y {
    %0 = tai.load @y[%i] : f64
    %1 = math.sin %0 : f64
    tai.atomic add %1, @loss[] : f64
  }
  tai.return
}

// Iterations that are run again in two places, and after a branch.
tai.kernel @rerun_twice() {
  %c0 = arith.constant 0 : index
  %0 = tai.load @b[] : f64
  %1 = math.sin %0 : f64
  tai.store %1, @b[] : f64
  %2 = tai.load @b[] : f64
  %3 = math.exp %2 : f64
  tai.store %3, @b[] : f64
  tai.parallel_for (%i) in @y {
    %4 = tai.load @y[%i] : f64
    %5 = arith.mulf %4, %2 : f64
    %6 = math.sin %5 : f64
    tai.store %6, @y[%i] : f64
    %7 = tai.load @y[%i] : f64
    %8 = math.sin %7 : f64
    tai.store %8, @y[%i] : f64
  }
  tai.return
}
tai.kernel @rerun_branch(%c: i1) {
  tai.parallel_for (%i) in @y {
    %r = scf.if %c -> f64 {
      %0 = tai.load @y[%i] : f64
      %1 = math.sin %0 : f64
      scf.yield %1 : f64
    } else {
      %0 = tai.load @y[%i] : f64
      scf.yield %0 : f64
    }
    %s = math.exp %r : f64
    tai.store %s, @y[%i] : f64
    %2 = tai.load @y[%i] : f64
    %3 = arith.mulf %2, %r : f64
    %4 = math.sin %3 : f64
    tai.store %4, @y[%i] : f64
  }
  tai.return
}
tai.kernel @set_b() {
  %c0 = arith.constant 0 : index
  %0 = tai.load @x[%c0] : f64
  tai.store %0, @b[] : f64
  tai.return
}

// Integers that a loop carries, and that are found again from their end: counted
// down, subtracted from another that changes, and vectors times an odd number.
tai.kernel @counters(%n: index, %by: i32) {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  %start = arith.constant 7 : i32
  %c3 = arith.constant 3 : i32
  %v = arith.constant dense<[3, 5]> : vector<2xi32>
  %three = arith.constant dense<3> : vector<2xi32>
  %small = arith.constant 0.05 : f64
  tai.parallel_for (%i) in @x {
    %0 = tai.load @x[%i] : f64
    %r:5 = scf.for %k = %c0 to %n step %c1 iter_args(%a = %0, %d = %start, %e = %start, %w = %v, %h = %start) -> (f64, i32, i32, vector<2xi32>, i32) {
      %p = vector.extract %w[0] : i32 from vector<2xi32>
      %q = arith.addi %d, %e : i32
      %t = arith.muli %q, %p : i32
      %t2 = arith.addi %t, %h : i32
      %f = arith.sitofp %t2 : i32 to f64
      %g = arith.mulf %f, %small : f64
      %b = arith.mulf %a, %g : f64
      %sin = math.sin %b : f64
      %d2 = arith.subi %d, %by : i32
      %e2 = arith.subi %c3, %e : i32
      %w2 = arith.muli %w, %three : vector<2xi32>
      %h2 = arith.subi %h, %d : i32
      scf.yield %sin, %d2, %e2, %w2, %h2 : f64, i32, i32, vector<2xi32>, i32
    }
    tai.atomic add %r#0, @loss[] : f64
  }
  tai.return
}

// A greatest value of serial loops that count in narrow integers, by steps.
tai.kernel @greatest(%from: i32, %to: i32) {
  %c0 = arith.constant 0 : index
  %two = arith.constant 2 : i32
  %small = arith.constant 0.1 : f64
  tai.parallel_for (%i) in @x {
    scf.for %k = %from to %to step %two : i32 {
      %0 = tai.load @x[%i] : f64
      %f = arith.sitofp %k : i32 to f64
      %1 = arith.mulf %0, %f : f64
      %2 = math.sin %1 : f64
      tai.atomic max %2, @loss[] : f64
    }
  }
  tai.return
}

func.func @main() {
  %zero = arith.constant 0.0 : f64
  %low = arith.constant -100.0 : f64
  %n = arith.constant 3 : index
  %true = arith.constant true
  %false = arith.constant false
  %m5 = arith.constant -5 : i64
  %p4 = arith.constant 4 : i64
  %p2 = arith.constant 2 : i64
  %p3 = arith.constant 3 : i64
  %from = arith.constant -3 : i32
  %to = arith.constant 4 : i32
  tai.launch @fill() : () -> ()
  tai_check.gradient loss(@loss) wrt [@x] tolerance 1.0e-7 {
    tai.store %zero, @loss[] : f64
    tai.launch @wide_counter(%m5, %p4, %p2) : (i64, i64, i64) -> ()
    tai.launch @wide_counter(%p2, %p4, %p3) : (i64, i64, i64) -> ()
  }
  tai_check.gradient loss(@loss) wrt [@v] tolerance 1.0e-8 {
    tai.store %zero, @loss[] : f64
    tai.launch @components_only() : () -> ()
  }
  tai_check.gradient loss(@loss) wrt [@x, @z] tolerance 1.0e-8 {
    tai.store %zero, @loss[] : f64
    tai.launch @captured(%n) : (index) -> ()
    tai.launch @captured_after_many() : () -> ()
  }
  tai_check.gradient loss(@loss) wrt [@x] tolerance 1.0e-8 {
    tai.store %zero, @loss[] : f64
    tai.launch @copy() : () -> ()
    tai.launch @rerun(%true) : (i1) -> ()
    tai.launch @rerun(%false) : (i1) -> ()
    tai.launch @sum() : () -> ()
  }
  tai_check.gradient loss(@loss) wrt [@x] tolerance 1.0e-7 {
    tai.store %zero, @loss[] : f64
    tai.launch @copy() : () -> ()
    tai.launch @set_b() : () -> ()
    tai.launch @rerun_twice() : () -> ()
    tai.launch @rerun_branch(%true) : (i1) -> ()
    tai.launch @rerun_branch(%false) : (i1) -> ()
    tai.launch @sum() : () -> ()
  }
  tai_check.gradient loss(@loss) wrt [@x] tolerance 1.0e-6 {
    %five = arith.constant 5 : index
    %two = arith.constant 2 : i32
    tai.store %zero, @loss[] : f64
    tai.launch @counters(%five, %two) : (index, i32) -> ()
  }
  tai_check.gradient loss(@loss) wrt [@x] tolerance 1.0e-8 {
    tai.store %low, @loss[] : f64
    tai.launch @greatest(%from, %to) : (i32, i32) -> ()
  }
  return
}
