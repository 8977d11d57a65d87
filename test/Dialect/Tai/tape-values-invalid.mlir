// RUN: tai-opt %s --split-input-file --verify-diagnostics

// A tape records launches. A value that goes from one to the next through the
// host would take part in the program and not in its gradient.
tai.tree @t : !tai.root<{x: f64, gx: f64, loss: f64, gl: f64, c: f64}>
tai.field @gx = @t["gx"] : f64, rank 0
tai.field @gl = @t["gl"] : f64, rank 0
tai.field @x = @t["x"] : f64, rank 0, adjoint @gx
tai.field @loss = @t["loss"] : f64, rank 0, adjoint @gl
tai.field @c = @t["c"] : f64, rank 0
tai.kernel @read() -> f64 {
  %0 = tai.load @x[] : f64
  tai.return %0 : f64
}
tai.kernel @use(%s: f64) {
  tai.store %s, @loss[] : f64
  tai.return
}
func.func @main() {
  tai.tape loss(@loss) {
    // expected-note @+1 {{made here}}
    %s = tai.launch @read() : () -> f64
    // expected-error @+2 {{gets a number that a taped launch made, through the host: the tape would lose its derivative}}
    // expected-note @+1 {{pass it in a field, from kernel to kernel; or say that it is a constant, by 'tai.stop_gradient'}}
    tai.launch @use(%s) : (f64) -> ()
  }
  return
}

// -----

// Through arithmetic, a loop and a function; a check of a gradient is a tape.
tai.tree @t : !tai.root<{x: f64, gx: f64, loss: f64, gl: f64}>
tai.field @gx = @t["gx"] : f64, rank 0
tai.field @gl = @t["gl"] : f64, rank 0
tai.field @x = @t["x"] : f64, rank 0, adjoint @gx
tai.field @loss = @t["loss"] : f64, rank 0, adjoint @gl
tai.kernel @use(%s: f64) {
  tai.store %s, @loss[] : f64
  tai.return
}
func.func private @through(%a: f64) -> f64 {
  %0 = arith.mulf %a, %a : f64
  return %0 : f64
}
func.func @main() {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  %c4 = arith.constant 4 : index
  %zero = arith.constant 0.0 : f64
  tai_check.gradient loss(@loss) wrt [@x] tolerance 1.0e-7 {
    %s = tai.load @x[] : f64
    // expected-note @+1 {{made here}}
    %r = scf.for %i = %c0 to %c4 step %c1 iter_args(%a = %zero) -> f64 {
      %t = func.call @through(%s) : (f64) -> f64
      %u = arith.addf %a, %t : f64
      scf.yield %u : f64
    }
    // expected-error @+2 {{gets a number that a taped launch made}}
    // expected-note @+1 {{pass it in a field}}
    tai.launch @use(%r) : (f64) -> ()
  }
  return
}

// -----

// In a function that the tape runs.
tai.tree @t : !tai.root<{x: f64, gx: f64, loss: f64, gl: f64}>
tai.field @gx = @t["gx"] : f64, rank 0
tai.field @gl = @t["gl"] : f64, rank 0
tai.field @x = @t["x"] : f64, rank 0, adjoint @gx
tai.field @loss = @t["loss"] : f64, rank 0, adjoint @gl
func.func @step() {
  // expected-note @+1 {{made here}}
  %s = tai.load @x[] : f64
  // expected-error @+2 {{stores a number that a taped launch made}}
  // expected-note @+1 {{pass it in a field}}
  tai.store %s, @loss[] : f64
  return
}
func.func @main() {
  tai.tape loss(@loss) {
    func.call @step() : () -> ()
  }
  return
}

// -----

// A field that a launch has seen is changed behind the back of the tape.
tai.tree @t : !tai.root<{x: f64, gx: f64, loss: f64, gl: f64, c: f64}>
tai.field @gx = @t["gx"] : f64, rank 0
tai.field @gl = @t["gl"] : f64, rank 0
tai.field @x = @t["x"] : f64, rank 0, adjoint @gx
tai.field @loss = @t["loss"] : f64, rank 0, adjoint @gl
tai.field @c = @t["c"] : f64, rank 0
tai.kernel @add() {
  %0 = tai.load @x[] : f64
  %1 = tai.load @c[] : f64
  %2 = arith.mulf %0, %1 : f64
  %3 = tai.atomic add %2, @loss[] : f64
  tai.return
}
func.func @main() {
  %two = arith.constant 2.0 : f64
  // expected-note @+1 {{store it before the tape, or in a kernel that is launched here}}
  tai.tape loss(@loss) {
    tai.launch @add() : () -> ()
    // expected-error @+1 {{changes '@c' between launches of a tape, which does not record what the host stores}}
    tai.store %two, @c[] : f64
    tai.launch @add() : () -> ()
  }
  return
}

// -----

// In a loop, code before the launch comes behind it as well.
tai.tree @t : !tai.root<{x: f64, gx: f64, loss: f64, gl: f64, c: f64}>
tai.field @gx = @t["gx"] : f64, rank 0
tai.field @gl = @t["gl"] : f64, rank 0
tai.field @x = @t["x"] : f64, rank 0, adjoint @gx
tai.field @loss = @t["loss"] : f64, rank 0, adjoint @gl
tai.field @c = @t["c"] : f64, rank 0
tai.kernel @add() {
  %0 = tai.load @x[] : f64
  %1 = tai.load @c[] : f64
  %2 = arith.mulf %0, %1 : f64
  %3 = tai.atomic add %2, @loss[] : f64
  tai.return
}
func.func @main() {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  %c4 = arith.constant 4 : index
  // expected-note @+1 {{store it before the tape}}
  tai.tape loss(@loss) {
    scf.for %i = %c0 to %c4 step %c1 {
      %n = arith.index_cast %i : index to i64
      %f = arith.sitofp %n : i64 to f64
      // expected-error @+1 {{changes '@c' between launches of a tape}}
      tai.store %f, @c[] : f64
      tai.launch @add() : () -> ()
    }
  }
  return
}
