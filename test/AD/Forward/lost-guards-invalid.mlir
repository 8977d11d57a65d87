// RUN: tai-opt %s --tai-forward-diff --split-input-file --verify-diagnostics

tai.tree @t : !tai.root<dense<[i: 8], {x: f64, dx: f64}>>
tai.field @dx = @t["dx"] : f64, rank 1
tai.field @x = @t["x"] : f64, rank 1, dual @dx

// The guard of an infinite derivative against a zero adjoint would be a branch,
// and its derivative zero where it is not.
tai.kernel @gradient() attributes {guarded} {
  tai.parallel_for (%i) in @x {
    %zero = arith.constant 0.0 : f64
    %0 = tai.load @x[%i] : f64
    %1 = math.log %0 : f64
    %isZero = arith.cmpf oeq, %0, %zero : f64
    // expected-error @below {{a guard of this gradient has lost its mark 'tai.guard', so that the gradient cannot be differentiated again}}
    %2 = arith.select %isZero, %zero, %1 : f64
    tai.store %2, @x[%i] : f64
  }
  tai.return
}

// -----

tai.tree @t : !tai.root<dense<[i: 8], {x: f64, dx: f64}>>
tai.field @dx = @t["dx"] : f64, rank 1
tai.field @x = @t["x"] : f64, rank 1, dual @dx

// With the mark, it is differentiated; a branch of the program may look like it.
tai.kernel @kept() attributes {guarded} {
  tai.parallel_for (%i) in @x {
    %zero = arith.constant 0.0 : f64
    %0 = tai.load @x[%i] : f64
    %1 = arith.mulf %0, %0 : f64
    %isZero = arith.cmpf oeq, %0, %zero : f64
    %2 = arith.select %isZero, %zero, %1 {tai.guard} : f64
    %3 = arith.select %isZero, %zero, %2 : f64
    tai.store %3, @x[%i] : f64
  }
  tai.return
}

// -----

tai.tree @t : !tai.root<dense<[i: 8], {x: f64, dx: f64}>>
tai.field @dx = @t["dx"] : f64, rank 1
tai.field @x = @t["x"] : f64, rank 1, dual @dx

// A branch to another value is no guard, and one that was folded away is not
// lost.
tai.kernel @other_value() attributes {guarded} {
  tai.parallel_for (%i) in @x {
    %zero = arith.constant 0.0 : f64
    %0 = tai.load @x[%i] : f64
    %1 = arith.mulf %0, %0 : f64
    %isZero = arith.cmpf oeq, %0, %zero : f64
    %2 = arith.select %isZero, %0, %1 : f64
    tai.store %2, @x[%i] : f64
  }
  tai.return
}
