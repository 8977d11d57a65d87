// The angle of a pendulum after 100 steps of symplectic Euler, from a state of two
// numbers: the angle and its velocity.
func.func @swing(%state: memref<2xf64>, %angle: memref<f64>)
    attributes {tai.differentiate, llvm.emit_c_interface} {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  %c100 = arith.constant 100 : index
  %h = arith.constant 0.01 : f64
  %q0 = memref.load %state[%c0] : memref<2xf64>
  %p0 = memref.load %state[%c1] : memref<2xf64>
  %q1, %p1 = scf.for %i = %c0 to %c100 step %c1 iter_args(%q = %q0, %p = %p0) -> (f64, f64) {
    %s = math.sin %q : f64
    %f = arith.mulf %h, %s : f64
    %p2 = arith.subf %p, %f : f64
    %v = arith.mulf %h, %p2 : f64
    %q2 = arith.addf %q, %v : f64
    scf.yield %q2, %p2 : f64, f64
  }
  memref.store %q1, %angle[] : memref<f64>
  return
}
