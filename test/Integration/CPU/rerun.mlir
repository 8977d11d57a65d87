// RUN: tai-opt %s --tai-make-adjoint="kernel=many,until zero-overwritten=true" | sed "s/launch @adjoint_of_\([a-z]*\)/launch @\1_grad/" | tai-run - --no-cache
// RUN: tai-opt %s --tai-make-adjoint="kernel=many,until zero-overwritten=true" | sed "s/launch @adjoint_of_\([a-z]*\)/launch @\1_grad/" | tai-run - --no-cache --opt-level=0 --threads=2

// Adjoints that run their kernel forward again, launched by hand on the former
// values. Each stack grows many times.

tai.tree @t : !tai.root<dense<[i: 5], {x: f64, x_grad: f64, want: f64}>>
tai.field @x_grad = @t["x_grad"] : f64, rank 1
tai.field @x = @t["x"] : f64, rank 1, adjoint @x_grad
tai.field @want = @t["want"] : f64, rank 1

// x starts from 0.1 to 0.9; the adjoints of a kernel's outputs are 1.
tai.kernel @start() {
  %one = arith.constant 1.0 : f64
  %scale = arith.constant 0.2 : f64
  %low = arith.constant 0.1 : f64
  tai.parallel_for (%i) in @x {
    %k = arith.index_cast %i : index to i32
    %f = arith.sitofp %k : i32 to f64
    %v = math.fma %f, %scale, %low : f64
    tai.store %v, @x[%i] : f64
    tai.store %one, @x_grad[%i] : f64
  }
  tai.return
}

// x = cos(x), 1000 times; the derivative carried along.
tai.kernel @many() {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  %c1000 = arith.constant 1000 : index
  tai.parallel_for (%i) in @x {
    scf.for %k = %c0 to %c1000 step %c1 {
      %0 = tai.load @x[%i] : f64
      %1 = math.cos %0 : f64
      %2 = math.exp %1 : f64
      %3 = math.log %2 : f64
      tai.store %3, @x[%i] : f64
    }
  }
  tai.return
}
tai.kernel @many_forward() {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  %c1000 = arith.constant 1000 : index
  %one = arith.constant 1.0 : f64
  tai.parallel_for (%i) in @x {
    %x = tai.load @x[%i] : f64
    %r:2 = scf.for %k = %c0 to %c1000 step %c1 iter_args(%v = %x, %d = %one) -> (f64, f64) {
      %cos = math.cos %v : f64
      %sin = math.sin %v : f64
      %minus = arith.negf %sin : f64
      %e = arith.mulf %d, %minus : f64
      scf.yield %cos, %e : f64, f64
    }
    tai.store %r#1, @want[%i] : f64
  }
  tai.return
}

// x = x (1 + x / 100) until it exceeds 1.
tai.kernel @until() {
  %one = arith.constant 1.0 : f64
  %rate = arith.constant 0.01 : f64
  tai.parallel_for (%i) in @x {
    scf.while : () -> () {
      %0 = tai.load @x[%i] : f64
      %more = arith.cmpf olt, %0, %one : f64
      scf.condition(%more)
    } do {
      %0 = tai.load @x[%i] : f64
      %1 = arith.mulf %0, %rate : f64
      %2 = arith.addf %1, %one : f64
      %3 = arith.mulf %0, %2 : f64
      tai.store %3, @x[%i] : f64
      scf.yield
    }
  }
  tai.return
}
tai.kernel @until_forward() {
  %one = arith.constant 1.0 : f64
  %rate = arith.constant 0.01 : f64
  %twice = arith.constant 0.02 : f64
  tai.parallel_for (%i) in @x {
    %x = tai.load @x[%i] : f64
    %r:2 = scf.while (%v = %x, %d = %one) : (f64, f64) -> (f64, f64) {
      %more = arith.cmpf olt, %v, %one : f64
      scf.condition(%more) %v, %d : f64, f64
    } do {
    ^bb0(%v: f64, %d: f64):
      %1 = math.fma %v, %rate, %one : f64
      %2 = arith.mulf %v, %1 : f64
      %3 = math.fma %v, %twice, %one : f64
      %4 = arith.mulf %d, %3 : f64
      scf.yield %2, %4 : f64, f64
    }
    tai.store %r#1, @want[%i] : f64
  }
  tai.return
}

// How many elements of x_grad are off.
tai.kernel @wrong() -> f64 {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  %c5 = arith.constant 5 : index
  %zero = arith.constant 0.0 : f64
  %one = arith.constant 1.0 : f64
  %part = arith.constant 1.0e-9 : f64
  %n = scf.for %i = %c0 to %c5 step %c1 iter_args(%sum = %zero) -> f64 {
    %g = tai.load @x_grad[%i] : f64
    %w = tai.load @want[%i] : f64
    %d = arith.subf %g, %w : f64
    %off = math.absf %d : f64
    %size = math.absf %w : f64
    %most = arith.mulf %size, %part : f64
    %right = arith.cmpf ole, %off, %most : f64
    %nonzero = arith.cmpf one, %w, %zero : f64
    %fine = arith.andi %right, %nonzero : i1
    %more = arith.select %fine, %zero, %one : f64
    %next = arith.addf %sum, %more : f64
    scf.yield %next : f64
  }
  tai.return %n : f64
}

// The launches of these become launches of the adjoints, once there are any.
tai.kernel @adjoint_of_many() {
  tai.return
}
tai.kernel @adjoint_of_until() {
  tai.return
}

func.func @main() {
  %zero = arith.constant 0.0 : f64
  tai.launch @start() : () -> ()
  tai.launch @many_forward() : () -> ()
  tai.launch @adjoint_of_many() : () -> ()
  %0 = tai.launch @wrong() : () -> f64
  tai_check.close %0, %zero tolerance 0.1 : f64
  tai.launch @start() : () -> ()
  tai.launch @until_forward() : () -> ()
  tai.launch @adjoint_of_until() : () -> ()
  %1 = tai.launch @wrong() : () -> f64
  tai_check.close %1, %zero tolerance 0.1 : f64
  return
}
