// RUN: tai-opt %s --tai-make-adjoint --verify-diagnostics

// Programs that need two versions of a field at once.

!t = !tai.root<dense<[i: 16], {x: f64, gx: f64, y: f64, gy: f64, n: i32}>, dense<[i: 4, j: 16], {z: f64, gz: f64}>>
tai.tree @t : !t
tai.field @gx = @t["gx"] : f64, rank 1
tai.field @gy = @t["gy"] : f64, rank 1
tai.field @gz = @t["gz"] : f64, rank 2
tai.field @x = @t["x"] : f64, rank 1, adjoint @gx
tai.field @y = @t["y"] : f64, rank 1, adjoint @gy
tai.field @z = @t["z"] : f64, rank 2, adjoint @gz
tai.field @n = @t["n"] : i32, rank 1
tai.kernel @read_written_row() {
  %c0 = arith.constant 0 : index
  %c2 = arith.constant 2 : index
  tai.parallel_for (%i) in @x {
    %0 = tai.load @x[%i] : f64
    // expected-note @+1 {{the value is written here}}
    tai.store %0, @z[%c2, %i] : f64
  }
  tai.parallel_for (%i) in @x {
    %0 = tai.load @x[%i] : f64
    // expected-error @+2 {{the value read here is needed by the gradient, and another update of the field needs what stood there before the kernel}}
    // expected-note @+1 {{put the update into a kernel of its own}}
    %1 = tai.load @z[%c2, %i] : f64
    %2 = arith.mulf %0, %1 : f64
    tai.atomic max %2, @z[%c0, %c0] : f64
  }
  tai.return
}

// A function has no tape that could restore a field.
func.func @function_in_place() attributes {tai.differentiate} {
  tai.parallel_for (%i) in @x {
    // expected-error @+2 {{the value read here is needed by the gradient, but is overwritten}}
    // expected-note @+1 {{store the new value to another element, such as one more time step of the field}}
    %0 = tai.load @x[%i] : f64
    %1 = math.sin %0 : f64
    // expected-note @+1 {{overwritten here}}
    tai.store %1, @x[%i] : f64
  }
  return
}

// Another loop reads the field before, or after, its iterations overwrite it.
tai.kernel @read_after_loop() {
  tai.parallel_for (%i) in @x {
    // expected-error @+2 {{the value read here is needed by the gradient, but is overwritten}}
    // expected-note @+1 {{store the new value to another element, such as one more time step of the field}}
    %0 = tai.load @x[%i] : f64
    %1 = math.sin %0 : f64
    // expected-note @+2 {{overwritten here}}
    // expected-note @+1 {{and what stood there before is replaced here}}
    tai.store %1, @x[%i] : f64
    // expected-note @+1 {{the gradient also needs the value read here}}
    %2 = tai.load @x[%i] : f64
    %3 = math.sin %2 : f64
    tai.store %3, @x[%i] : f64
  }
  tai.parallel_for (%i) in @x {
    %0 = tai.load @x[%i] : f64
    %1 = math.sin %0 : f64
    tai.store %1, @y[%i] : f64
  }
  tai.return
}
tai.kernel @read_before_loop() {
  tai.parallel_for (%i) in @x {
    // expected-error @+2 {{the value read here is needed by the gradient, but is overwritten}}
    // expected-note @+1 {{store the new value to another element, such as one more time step of the field}}
    %0 = tai.load @x[%i] : f64
    %1 = math.sin %0 : f64
    tai.store %1, @y[%i] : f64
  }
  tai.parallel_for (%i) in @x {
    %0 = tai.load @x[%i] : f64
    %1 = math.sin %0 : f64
    // expected-note @+2 {{overwritten here}}
    // expected-note @+1 {{and what stood there before is replaced here}}
    tai.store %1, @x[%i] : f64
    // expected-note @+1 {{the gradient also needs the value read here}}
    %2 = tai.load @x[%i] : f64
    %3 = math.sin %2 : f64
    tai.store %3, @x[%i] : f64
  }
  tai.return
}
