// RUN: tai-opt %s --tai-expand-gradients --split-input-file --verify-diagnostics

func.func @first(%x: f64) -> f64 {
  %one = arith.constant 1.0 : f64
  %0 = tai.grad @square(%x, %one) : (f64, f64) -> f64
  return %0 : f64
}
func.func @square(%x: f64) -> f64 {
  %0 = arith.mulf %x, %x : f64
  return %0 : f64
}
func.func @second(%x: f64) -> f64 {
  %one = arith.constant 1.0 : f64
  // expected-error @+1 {{'tai.grad' op cannot differentiate '@first', which has a 'tai.grad' itself: higher derivatives are not made}}
  %0 = tai.grad @first(%x, %one) : (f64, f64) -> f64
  return %0 : f64
}

// -----

// The error of an op without a rule stands at that op.
func.func @user(%x: f64) -> f64 {
  %one = arith.constant 1.0 : f64
  %0 = tai.grad @opaque(%x, %one) : (f64, f64) -> f64
  return %0 : f64
}
func.func @opaque(%x: f64) -> f64 {
  // expected-error @+2 {{'arith.bitcast' has no derivative rule, but a gradient passes through it}}
  // expected-note @+1 {{compute the value from differentiable ops, or keep it out of what the gradient is taken of}}
  %b = arith.bitcast %x : f64 to i64
  %0 = arith.bitcast %b : i64 to f64
  return %0 : f64
}
