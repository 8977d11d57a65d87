// RUN: tai-opt %s --tai-make-adjoint --split-input-file --verify-diagnostics

// Signatures.
// expected-error @+1 {{expects 'tai.gradients' to be an array of positions in ascending order}}
func.func @bad_gradients(%x: f64, %y: memref<f64>) attributes {tai.differentiate, tai.gradients = "x"} {
  return
}

// -----

// expected-error @+1 {{cannot differentiate by position -1: there are 2 arguments and 0 results}}
func.func @low_position(%x: f64, %y: memref<f64>) attributes {tai.differentiate, tai.gradients = array<i64: -1, 1>} {
  return
}

// -----

// expected-error @+1 {{cannot differentiate by position 2: there are 2 arguments and 0 results}}
func.func @high_position(%x: f64, %y: memref<f64>) attributes {tai.differentiate, tai.gradients = array<i64: 0, 2>} {
  return
}

// -----

// Arrays of the function's own are no variables, nor are those that it does not
// name.
// expected-error @+2 {{there is nothing to differentiate}}
// expected-note @+1 {{pass arrays, or name arguments and results}}
func.func @only_local(%y: memref<f64>) attributes {tai.differentiate} {
  %c0 = arith.constant 0 : index
  %m = memref.alloc() : memref<f64>
  %one = arith.constant 1.0 : f64
  memref.store %one, %m[] : memref<f64>
  return
}

// -----

// expected-error @+2 {{there is nothing to differentiate}}
// expected-note @+1 {{pass arrays, or name arguments and results}}
func.func @not_selected(%x: memref<f64>, %y: memref<f64>, %z: memref<f64>) attributes {tai.differentiate, tai.gradients = array<i64: 2>} {
  %0 = memref.load %x[] : memref<f64>
  %1 = memref.load %z[] : memref<f64>
  %2 = arith.mulf %0, %1 : f64
  memref.store %2, %y[] : memref<f64>
  return
}

// -----

// An array goes through no loop, no call and no other array.
func.func @inner_argument(%x: memref<f64>, %y: memref<f64>, %n: index) attributes {tai.differentiate} {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  // expected-error @+2 {{cannot differentiate 'scf.for' on an array with a derivative}}
  // expected-note @+1 {{run '--tai-prepare-foreign' before}}
  %m = scf.for %i = %c0 to %n step %c1 iter_args(%a = %x) -> memref<f64> {
    %v = memref.load %a[] : memref<f64>
    scf.yield %a : memref<f64>
  }
  return
}

// -----

func.func @array_of_arrays(%x: memref<4xf64>, %z: memref<2xmemref<4xf64>>) attributes {tai.differentiate} {
  %c0 = arith.constant 0 : index
  // expected-error @+2 {{cannot differentiate 'memref.store' on an array with a derivative}}
  // expected-note @+1 {{access its elements by}}
  memref.store %x, %z[%c0] : memref<2xmemref<4xf64>>
  return
}

// -----

func.func private @take(memref<4xf64>)
func.func @call_with_array(%x: memref<4xf64>) attributes {tai.differentiate} {
  // expected-error @+2 {{cannot differentiate 'func.call' on an array with a derivative}}
  // expected-note @+1 {{run 'inline' first; a function that calls itself, or that is defined elsewhere, cannot be differentiated}}
  call @take(%x) : (memref<4xf64>) -> ()
  return
}

// -----

// A call may change anything, even one without operands.
func.func private @note()
func.func @calls(%x: memref<4xf64>, %y: memref<4xf64>) attributes {tai.differentiate} {
  %c0 = arith.constant 0 : index
  %0 = memref.load %x[%c0] : memref<4xf64>
  memref.store %0, %y[%c0] : memref<4xf64>
  // expected-error @+2 {{cannot differentiate a call that was not inlined}}
  // expected-note @+1 {{run 'inline' first}}
  call @note() : () -> ()
  return
}

// -----

// Updates of arrays other than sums.
func.func @max_of_float_array(%x: memref<4xf64>, %y: memref<4xf64>) attributes {tai.differentiate} {
  %c0 = arith.constant 0 : index
  %0 = memref.load %x[%c0] : memref<4xf64>
  // expected-error @+2 {{this product, minimum or maximum of an element of an array has no gradient}}
  // expected-note @+1 {{combine into a field that has a gradient}}
  memref.atomic_rmw maximumf %0, %y[%c0] : (f64, memref<4xf64>) -> f64
  return
}

// -----

// How many components there are to record is known when it runs.
func.func @scalable_carried(%x: memref<f64>, %y: memref<f64>, %n: index) attributes {tai.differentiate} {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  %v = arith.constant dense<1.0> : vector<[2]xf64>
  %w = arith.constant dense<2.0> : vector<[2]xf64>
  %0 = memref.load %x[] : memref<f64>
  // expected-error @+2 {{those of type 'vector<[2]xf64>' cannot be recorded}}
  // expected-note @+1 {{carry numbers, or vectors of a fixed length}}
  %r:2 = scf.for %i = %c0 to %n step %c1 iter_args(%s = %v, %a = %0) -> (vector<[2]xf64>, f64) {
    %e = vector.extract %s[0] : f64 from vector<[2]xf64>
    %p = arith.mulf %a, %e : f64
    %t = arith.mulf %s, %w : vector<[2]xf64>
    scf.yield %t, %p : vector<[2]xf64>, f64
  }
  memref.store %r#1, %y[] : memref<f64>
  return
}

// -----

// A declaration of another type is another function.
// expected-note @+1 {{by this}}
func.func private @f_grad(%x: memref<f32>)
// expected-error @+1 {{cannot make the adjoint '@f_grad': the name is taken}}
func.func @f(%x: memref<f64>, %y: memref<f64>) attributes {tai.differentiate} {
  %0 = memref.load %x[] : memref<f64>
  memref.store %0, %y[] : memref<f64>
  return
}

// -----

// A region of several blocks.
func.func @several_blocks(%x: memref<4xf64>, %y: memref<4xf64>, %c: i1) attributes {tai.differentiate} {
  %c0 = arith.constant 0 : index
  %0 = memref.load %x[%c0] : memref<4xf64>
  // expected-error @+1 {{'scf.execute_region' has several blocks and is needed by the gradient; structured control flow is expected}}
  %k = scf.execute_region -> f64 {
    cf.cond_br %c, ^a, ^b
  ^a:
    %one = arith.constant 1.0 : f64
    scf.yield %one : f64
  ^b:
    %two = arith.constant 2.0 : f64
    scf.yield %two : f64
  }
  %1 = arith.mulf %0, %k : f64
  memref.store %1, %y[%c0] : memref<4xf64>
  return
}
