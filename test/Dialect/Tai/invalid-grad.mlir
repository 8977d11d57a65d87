// RUN: tai-opt %s --split-input-file --verify-diagnostics

func.func @u(%x: f64) {
  // expected-error @+1 {{'tai.grad' op names '@nothing', which is no function with a body}}
  %0 = tai.grad @nothing(%x, %x) : (f64, f64) -> f64
  return
}

// -----

func.func private @f(f64) -> f64
func.func @u(%x: f64) {
  // expected-error @+1 {{'tai.grad' op names '@f', which is no function with a body}}
  %0 = tai.grad @f(%x, %x) : (f64, f64) -> f64
  return
}

// -----

// expected-note @+1 {{a kernel is differentiated by launches under a 'tai.tape'}}
tai.kernel @k() { tai.return }
func.func @u(%x: f64) {
  // expected-error @+1 {{'tai.grad' op names '@k', which is no function with a body}}
  %0 = tai.grad @k(%x) : (f64) -> f64
  return
}

// -----

func.func @f(%x: f64, %n: i32) -> f64 { return %x : f64 }
func.func @u(%x: f64, %n: i32) {
  // expected-error @+1 {{'tai.grad' op cannot differentiate by argument 1 of '@f', which is no float but 'i32'}}
  %0 = tai.grad @f(%x, %n, %x) wrt [1] : (f64, i32, f64) -> f64
  return
}

// -----

func.func @f(%x: f64, %n: i32) -> f64 { return %x : f64 }
func.func @u(%x: f64, %n: i32) {
  // expected-error @+1 {{'tai.grad' op names argument 2 of '@f', which has 2}}
  %0 = tai.grad @f(%x, %n, %x) wrt [2] : (f64, i32, f64) -> f64
  return
}

// -----

func.func @f(%x: f64, %y: f64) -> f64 { return %x : f64 }
func.func @u(%x: f64) {
  // expected-error @+1 {{'tai.grad' op expects the positions of arguments in ascending order}}
  %0:2 = tai.grad @f(%x, %x, %x) wrt [1, 0] : (f64, f64, f64) -> (f64, f64)
  return
}

// -----

func.func @f(%x: f64, %y: f64) -> f64 { return %x : f64 }
func.func @u(%x: f64) {
  // expected-error @+1 {{'tai.grad' op expects 3 operands: 2 arguments of '@f', 0 memrefs for gradients, and 1 derivatives of results, but got 2}}
  %0:2 = tai.grad @f(%x, %x) : (f64, f64) -> (f64, f64)
  return
}

// -----

func.func @f(%m: memref<4xf64>) -> f64 {
  %0 = arith.constant 1.0 : f64
  return %0 : f64
}
func.func @u(%m: memref<4xf64>, %g: memref<5xf64>, %s: f64) {
  // expected-error @+1 {{'tai.grad' op expects operand 1, the gradient of argument 0, to be 'memref<4xf64>', but got 'memref<5xf64>'}}
  tai.grad @f(%m, %g, %s) : (memref<4xf64>, memref<5xf64>, f64) -> ()
  return
}

// -----

func.func @f(%x: f64) -> f64 { return %x : f64 }
func.func @u(%x: f64, %s: f32) {
  // expected-error @+1 {{'tai.grad' op expects operand 1, the derivative by result 0, to be 'f64', but got 'f32'}}
  %0 = tai.grad @f(%x, %s) : (f64, f32) -> f64
  return
}

// -----

func.func @f(%x: f64) -> f64 { return %x : f64 }
func.func @u(%x: f64) {
  // expected-error @+1 {{'tai.grad' op expects the results 'f64', the gradients of numbers and vectors, but got}}
  tai.grad @f(%x, %x) : (f64, f64) -> ()
  return
}

// -----

func.func @f(%n: i32) -> i32 { return %n : i32 }
func.func @u(%n: i32) {
  // expected-error @+1 {{'tai.grad' op has nothing to differentiate: '@f' has no active argument}}
  tai.grad @f(%n) : (i32) -> ()
  return
}

// -----

func.func @f(%x: f64) -> i32 {
  %0 = arith.constant 1 : i32
  return %0 : i32
}
func.func @u(%x: f64) {
  // expected-error @+1 {{'tai.grad' op has nothing to differentiate: '@f' has no active result or memref}}
  %0 = tai.grad @f(%x) : (f64) -> f64
  return
}

// -----

tai.tree @t : !tai.root<{l: f32, g: f32}>
tai.field @g = @t["g"] : f32, rank 0
tai.field @l = @t["l"] : f32, rank 0, adjoint @g
func.func @main() {
  // expected-error @+1 {{the number of snapshots and the memory budget of a tape must be positive}}
  tai.tape loss(@l) checkpoint(<mixed budget -1>) {
  }
  return
}
