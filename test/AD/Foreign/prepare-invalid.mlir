// RUN: tai-opt %s --tai-prepare-foreign --split-input-file --verify-diagnostics

func.func @returns(%x: memref<4xf64>) -> memref<4xf64> attributes {tai.differentiate} {
  %t = memref.alloc() : memref<4xf64>
  // expected-error @+2 {{cannot differentiate a function that returns an array}}
  // expected-note @+1 {{run '--buffer-results-to-out-params=modify-public-functions' before}}
  return %t : memref<4xf64>
}

// -----

func.func @carried(%x: memref<4xf64>, %y: memref<4xf64>) attributes {tai.differentiate} {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  %c4 = arith.constant 4 : index
  // expected-note @+1 {{one of several arrays is chosen here; make them before, or copy to one of them ('memref.copy')}}
  %r = scf.for %i = %c0 to %c4 step %c1 iter_args(%a = %x) -> memref<4xf64> {
    // expected-error @+1 {{cannot differentiate an array that is made in a loop or branch and used outside of it}}
    %b = memref.alloc() : memref<4xf64>
    %0 = memref.load %a[%c0] : memref<4xf64>
    memref.store %0, %b[%c0] : memref<4xf64>
    scf.yield %b : memref<4xf64>
  }
  // The array that the loop hands on is written: it may be that of the caller.
  %1 = memref.load %r[%c0] : memref<4xf64>
  memref.store %1, %r[%c1] : memref<4xf64>
  memref.store %1, %y[%c0] : memref<4xf64>
  return
}

// -----

func.func @strided(%x: memref<12xf64, strided<[?], offset: ?>>, %y: memref<f64>) attributes {tai.differentiate} {
  %c0 = arith.constant 0 : index
  // expected-note @+1 {{made here, of memory whose layout is not known; view an array with the identity layout}}
  %v = memref.reinterpret_cast %x to offset: [3], sizes: [2], strides: [4] : memref<12xf64, strided<[?], offset: ?>> to memref<2xf64, strided<[4], offset: 3>>
  // expected-error @+1 {{cannot differentiate an access of this view}}
  %a = memref.load %v[%c0] : memref<2xf64, strided<[4], offset: 3>>
  memref.store %a, %y[] : memref<f64>
  return
}

// -----

func.func private @make(memref<64xi8>) -> memref<8xf64>
func.func @bytes(%x: memref<64xi8>, %y: memref<f64>) attributes {tai.differentiate} {
  %c0 = arith.constant 0 : index
  // expected-note @+1 {{it comes from here}}
  %v = func.call @make(%x) : (memref<64xi8>) -> memref<8xf64>
  // expected-error @+1 {{cannot differentiate an access of an array of unknown origin}}
  %a = memref.load %v[%c0] : memref<8xf64>
  memref.store %a, %y[] : memref<f64>
  return
}

// -----

// expected-error @+1 {{cannot differentiate a function of tensors and memrefs; use one of them}}
func.func @mixed(%x: tensor<4xf64>, %y: memref<4xf64>) -> tensor<4xf64> attributes {tai.differentiate} {
  return %x : tensor<4xf64>
}

// -----

// expected-error @+1 {{there is nothing to differentiate: this function takes or returns no tensor of floats}}
func.func @integers(%x: tensor<4xi32>) -> tensor<4xi32> attributes {tai.differentiate} {
  return %x : tensor<4xi32>
}

// -----

// expected-error @+1 {{a function of tensors is differentiated with respect to all tensors of floats: leave out 'tai.gradients'}}
func.func @positions(%x: tensor<4xf64>) -> tensor<4xf64> attributes {tai.differentiate, tai.gradients = array<i64: 0, 1>} {
  return %x : tensor<4xf64>
}

// -----

// expected-note @+1 {{by another function; write a loop, 'scf.for' or 'scf.while'}}
func.func private @power(%a: f64, %n: index) -> f64 {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  %one = arith.constant 1.0 : f64
  %z = arith.cmpi eq, %n, %c0 : index
  %r = scf.if %z -> f64 {
    scf.yield %one : f64
  } else {
    %m = arith.subi %n, %c1 : index
    %p = func.call @cube_again(%a, %m) : (f64, index) -> f64
    %q = arith.mulf %p, %a : f64
    scf.yield %q : f64
  }
  return %r : f64
}
func.func private @cube_again(%a: f64, %m: index) -> f64 {
  %p = func.call @power(%a, %m) : (f64, index) -> f64
  return %p : f64
}
func.func private @cube(%a: f64) -> f64 {
  %c3 = arith.constant 3 : index
  %0 = func.call @power(%a, %c3) : (f64, index) -> f64
  return %0 : f64
}
func.func @recursive(%x: memref<f64>, %y: memref<f64>) attributes {tai.differentiate} {
  %a = memref.load %x[] : memref<f64>
  // expected-error @+1 {{cannot differentiate this call: '@power' calls itself}}
  %b = func.call @cube(%a) : (f64) -> f64
  memref.store %b, %y[] : memref<f64>
  return
}

// -----

// A derivative of one's own is not left out.
// expected-note @+1 {{the derivative of a caller does not use @square_rule; remove 'tai.adjoint' here}}
func.func private @square(%x: memref<f64>, %y: memref<f64>) attributes {tai.adjoint = @square_rule} {
  %a = memref.load %x[] : memref<f64>
  %b = arith.mulf %a, %a : f64
  memref.store %b, %y[] : memref<f64>
  return
}
func.func private @square_rule(%x: memref<f64>, %y: memref<f64>, %dx: memref<f64>, %dy: memref<f64>) {
  return
}
func.func @calls_rule(%x: memref<f64>, %y: memref<f64>) attributes {tai.differentiate} {
  // expected-error @+1 {{cannot differentiate this call: '@square' has a derivative of its own}}
  call @square(%x, %y) : (memref<f64>, memref<f64>) -> ()
  return
}

// -----

func.func @bytes_of_the_caller(%b: memref<64xi8>, %x: memref<4xf64>) attributes {tai.differentiate} {
  // expected-note @-1 {{bytes of the caller have no adjoint; take the array as an argument}}
  %c0 = arith.constant 0 : index
  // expected-error @+1 {{cannot differentiate an array in these bytes}}
  %v = memref.view %b[%c0][] : memref<64xi8> to memref<4xf64>
  %a = memref.load %v[%c0] : memref<4xf64>
  memref.store %a, %x[%c0] : memref<4xf64>
  return
}

// -----

func.func @shared_bytes(%x: memref<4xf64>) attributes {tai.differentiate} {
  %c0 = arith.constant 0 : index
  %c8 = arith.constant 8 : index
  %b = memref.alloc() : memref<64xi8>
  // The last user comes first.
  // expected-error @+1 {{cannot differentiate an array in these bytes}}
  %u = memref.view %b[%c0][] : memref<64xi8> to memref<4xf64>
  // expected-note @+1 {{another array is in the same bytes; allocate both by 'memref.alloc'}}
  %v = memref.view %b[%c8][] : memref<64xi8> to memref<4xf64>
  memref.copy %x, %u : memref<4xf64> to memref<4xf64>
  memref.copy %v, %x : memref<4xf64> to memref<4xf64>
  memref.dealloc %b : memref<64xi8>
  return
}

// -----

func.func @place_of_bytes(%x: memref<4xf64>, %n: index) attributes {tai.differentiate} {
  %b = memref.alloc() : memref<64xi8>
  // expected-error @+2 {{cannot differentiate an array in these bytes}}
  // expected-note @+1 {{the place and the size of each array in the bytes must be constants}}
  %u = memref.view %b[%n][] : memref<64xi8> to memref<4xf64>
  memref.copy %x, %u : memref<4xf64> to memref<4xf64>
  memref.copy %u, %x : memref<4xf64> to memref<4xf64>
  memref.dealloc %b : memref<64xi8>
  return
}

// -----

// A function with two calls of itself.
// expected-note @+1 {{expects one call of itself, or a loop in its place, 'scf.for' or 'scf.while'}}
func.func private @fibonacci(%a: f64, %n: index) -> f64 {
  %c1 = arith.constant 1 : index
  %c2 = arith.constant 2 : index
  %z = arith.cmpi ult, %n, %c2 : index
  %r = scf.if %z -> f64 {
    scf.yield %a : f64
  } else {
    %m = arith.subi %n, %c1 : index
    %k = arith.subi %n, %c2 : index
    %p = func.call @fibonacci(%a, %m) : (f64, index) -> f64
    // expected-error @+1 {{cannot differentiate this call: '@fibonacci' calls itself}}
    %q = func.call @fibonacci(%a, %k) : (f64, index) -> f64
    %s = arith.mulf %p, %q : f64
    scf.yield %s : f64
  }
  return %r : f64
}
func.func @tree(%x: memref<f64>, %n: index) attributes {tai.differentiate} {
  %a = memref.load %x[] : memref<f64>
  %b = func.call @fibonacci(%a, %n) : (f64, index) -> f64
  memref.store %b, %x[] : memref<f64>
  return
}

// -----

// expected-note @+1 {{expects that nothing is written or allocated before the call}}
func.func private @writes(%x: memref<4xf64>, %n: index) {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  %z = arith.cmpi ne, %n, %c0 : index
  scf.if %z {
    %m = arith.subi %n, %c1 : index
    %a = memref.load %x[%c0] : memref<4xf64>
    %b = math.sin %a : f64
    memref.store %b, %x[%c0] : memref<4xf64>
    // expected-error @+1 {{cannot differentiate this call: '@writes' calls itself}}
    func.call @writes(%x, %m) : (memref<4xf64>, index) -> ()
  }
  return
}
func.func @before(%x: memref<4xf64>, %n: index) attributes {tai.differentiate} {
  func.call @writes(%x, %n) : (memref<4xf64>, index) -> ()
  return
}

// -----

// expected-note @+1 {{expects the call outside of loops}}
func.func private @looped(%x: memref<4xf64>, %n: index) {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  scf.for %i = %c0 to %n step %c1 {
    // expected-error @+1 {{cannot differentiate this call: '@looped' calls itself}}
    func.call @looped(%x, %i) : (memref<4xf64>, index) -> ()
    %a = memref.load %x[%c0] : memref<4xf64>
    %b = math.sin %a : f64
    memref.store %b, %x[%c0] : memref<4xf64>
  }
  return
}
func.func @in_a_loop(%x: memref<4xf64>, %n: index) attributes {tai.differentiate} {
  func.call @looped(%x, %n) : (memref<4xf64>, index) -> ()
  return
}

// -----

// expected-note @+1 {{expects the same arrays in each call}}
func.func private @swaps(%x: memref<4xf64>, %y: memref<4xf64>, %n: index) {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  %z = arith.cmpi ne, %n, %c0 : index
  scf.if %z {
    %m = arith.subi %n, %c1 : index
    // expected-error @+1 {{cannot differentiate this call: '@swaps' calls itself}}
    func.call @swaps(%y, %x, %m) : (memref<4xf64>, memref<4xf64>, index) -> ()
    %a = memref.load %x[%c0] : memref<4xf64>
    memref.store %a, %y[%c0] : memref<4xf64>
  }
  return
}
func.func @swapped(%x: memref<4xf64>, %y: memref<4xf64>, %n: index) attributes {tai.differentiate} {
  func.call @swaps(%x, %y, %n) : (memref<4xf64>, memref<4xf64>, index) -> ()
  return
}
