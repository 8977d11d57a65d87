// RUN: tai-opt %s --split-input-file --verify-diagnostics --tai-make-adjoint
// RUN: sed -e 's/no derivative rule, but a gradient/no tangent rule, but a tangent/' \
// RUN:   -e 's/what the gradient/what the derivative/' %s \
// RUN:   | tai-opt --split-input-file --verify-diagnostics --tai-forward-diff

// A value made from one with a derivative has one, whatever its type and
// whatever op makes it, unless the op is known to be discrete. Both modes say
// the same of the same programs.

func.func @bits(%x: memref<f64>, %y: memref<f64>) attributes {tai.differentiate} {
  %0 = memref.load %x[] : memref<f64>
  // expected-error @+2 {{'arith.bitcast' has no derivative rule, but a gradient passes through it}}
  // expected-note @+1 {{compute the value from differentiable ops, or keep it out of what the gradient is taken of}}
  %1 = arith.bitcast %0 : f64 to i64
  %2 = arith.bitcast %1 : i64 to f64
  %3 = arith.mulf %2, %2 : f64
  memref.store %3, %y[] : memref<f64>
  return
}

// -----

// Integer arithmetic on the bits is no way round.
func.func @sign(%x: memref<f64>, %y: memref<f64>) attributes {tai.differentiate} {
  %mask = arith.constant 0x7FFFFFFFFFFFFFFF : i64
  %0 = memref.load %x[] : memref<f64>
  // expected-error @+2 {{'arith.bitcast' has no derivative rule, but a gradient passes through it}}
  // expected-note @+1 {{compute the value}}
  %1 = arith.bitcast %0 : f64 to i64
  %2 = arith.andi %1, %mask : i64
  %3 = arith.sitofp %2 : i64 to f64
  memref.store %3, %y[] : memref<f64>
  return
}

// -----

func.func @vector_bits(%x: memref<f64>, %y: memref<f64>) attributes {tai.differentiate} {
  %0 = memref.load %x[] : memref<f64>
  %1 = vector.broadcast %0 : f64 to vector<2xf64>
  // expected-error @+2 {{'vector.bitcast' has no derivative rule, but a gradient passes through it}}
  // expected-note @+1 {{compute the value}}
  %2 = vector.bitcast %1 : vector<2xf64> to vector<2xi64>
  %3 = vector.bitcast %2 : vector<2xi64> to vector<2xf64>
  %4 = vector.extract %3[1] : f64 from vector<2xf64>
  memref.store %4, %y[] : memref<f64>
  return
}

// -----

func.func @structure(%x: memref<f64>, %y: memref<f64>) attributes {tai.differentiate} {
  %0 = memref.load %x[] : memref<f64>
  %1 = llvm.mlir.undef : !llvm.struct<(f64, i32)>
  // expected-error @+2 {{'llvm.insertvalue' has no derivative rule, but a gradient passes through it}}
  // expected-note @+1 {{run '--tai-prepare-foreign' before}}
  %2 = llvm.insertvalue %0, %1[0] : !llvm.struct<(f64, i32)>
  %3 = llvm.extractvalue %2[0] : !llvm.struct<(f64, i32)>
  memref.store %3, %y[] : memref<f64>
  return
}

// -----

func.func @cast(%x: memref<f64>, %y: memref<f64>) attributes {tai.differentiate} {
  %0 = memref.load %x[] : memref<f64>
  // expected-error @+2 {{'builtin.unrealized_conversion_cast' has no derivative rule, but a gradient passes through it}}
  // expected-note @+1 {{compute the value}}
  %1 = builtin.unrealized_conversion_cast %0 : f64 to i64
  %2 = builtin.unrealized_conversion_cast %1 : i64 to f64
  memref.store %2, %y[] : memref<f64>
  return
}

// -----

// Bits that a loop carries.
func.func @carried(%x: memref<f64>, %y: memref<f64>) attributes {tai.differentiate} {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  %c3 = arith.constant 3 : index
  %one = arith.constant 1 : i64
  %0 = memref.load %x[] : memref<f64>
  // expected-error @+2 {{'arith.bitcast' has no derivative rule, but a gradient passes through it}}
  // expected-note @+1 {{compute the value}}
  %1 = arith.bitcast %0 : f64 to i64
  %2 = scf.for %i = %c0 to %c3 step %c1 iter_args(%b = %1) -> i64 {
    %n = arith.addi %b, %one : i64
    scf.yield %n : i64
  }
  %3 = arith.bitcast %2 : i64 to f64
  memref.store %3, %y[] : memref<f64>
  return
}

// -----

// And bits that are stored.
func.func @stored(%x: memref<f64>, %b: memref<i64>, %y: memref<f64>) attributes {tai.differentiate} {
  %0 = memref.load %x[] : memref<f64>
  %1 = arith.mulf %0, %0 : f64
  %2 = arith.bitcast %1 : f64 to i64
  // expected-error @+2 {{a derivative is lost: what has one is stored as 'i64', which has none}}
  // expected-note @+1 {{make it a constant by 'tai.stop_gradient' first}}
  memref.store %2, %b[] : memref<i64>
  %3 = memref.load %b[] : memref<i64>
  // expected-error @+2 {{'arith.bitcast' reads floats from memory that derivatives are not followed through}}
  // expected-note @+1 {{load it from a field or from an argument that is a memref of floats}}
  %4 = arith.bitcast %3 : i64 to f64
  %5 = arith.mulf %4, %0 : f64
  memref.store %5, %y[] : memref<f64>
  return
}

// -----

func.func @pointer(%p: !llvm.ptr, %y: memref<f64>) attributes {tai.differentiate} {
  %0 = llvm.getelementptr %p[2] : (!llvm.ptr) -> !llvm.ptr, f64
  // expected-error @+2 {{'llvm.load' reads floats from memory that derivatives are not followed through}}
  // expected-note @+1 {{load it from a field}}
  %1 = llvm.load %0 : !llvm.ptr -> f64
  memref.store %1, %y[] : memref<f64>
  return
}

// -----

// An array behind an array.
func.func @nested(%p: memref<4xmemref<4xf64>>, %y: memref<f64>) attributes {tai.differentiate} {
  %c0 = arith.constant 0 : index
  %0 = memref.load %p[%c0] : memref<4xmemref<4xf64>>
  // expected-error @+2 {{'memref.load' reads floats from memory that derivatives are not followed through}}
  // expected-note @+1 {{load it from a field}}
  %1 = memref.load %0[%c0] : memref<4xf64>
  memref.store %1, %y[] : memref<f64>
  return
}

// -----

// Too late: fields cannot be recognised any more.
tai.tree @t : !tai.root<{x: f64, gx: f64, y: f64, gy: f64, dx: f64, dy: f64}>
tai.field @gx = @t["gx"] : f64, rank 0
tai.field @gy = @t["gy"] : f64, rank 0
tai.field @dx = @t["dx"] : f64, rank 0
tai.field @dy = @t["dy"] : f64, rank 0
tai.field @x = @t["x"] : f64, rank 0, adjoint @gx, dual @dx
tai.field @y = @t["y"] : f64, rank 0, adjoint @gy, dual @dy
// expected-note @+1 {{run 'tai-make-adjoint' and 'tai-forward-diff' before 'tai-lower-layout'}}
tai.kernel @late() {
  // expected-error @+1 {{cannot differentiate accesses that are lowered already}}
  %base = tai_rt.tree_base @t : !llvm.ptr
  %0 = llvm.load %base : !llvm.ptr -> f64
  %1 = arith.mulf %0, %0 : f64
  %2 = llvm.getelementptr %base[16] : (!llvm.ptr) -> !llvm.ptr, i8
  llvm.store %1, %2 : f64, !llvm.ptr
  tai.return
}

// -----

// An array that a loop carries might be any array.
func.func @carried_array(%x: memref<f64>, %y: memref<f64>) attributes {tai.differentiate} {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  %c3 = arith.constant 3 : index
  %buffer = memref.alloc() : memref<f64>
  %0 = memref.load %x[] : memref<f64>
  // expected-note @+1 {{access an argument of the function by its own name}}
  %last = scf.for %i = %c0 to %c3 step %c1 iter_args(%m = %buffer) -> memref<f64> {
    // expected-error @+1 {{a derivative is lost in an array that is not followed}}
    memref.store %0, %m[] : memref<f64>
    scf.yield %m : memref<f64>
  }
  %1 = memref.load %buffer[] : memref<f64>
  memref.store %1, %y[] : memref<f64>
  return
}

// -----

// Bits that are moved on their way are the same floats.
func.func @shuffled(%p: memref<?xvector<2xi32>>, %y: memref<f32>) attributes {tai.differentiate} {
  %c0 = arith.constant 0 : index
  %0 = memref.load %p[%c0] : memref<?xvector<2xi32>>
  %1 = vector.shuffle %0, %0 [1, 0] : vector<2xi32>, vector<2xi32>
  // expected-error @+2 {{'vector.bitcast' reads floats from memory that derivatives are not followed through}}
  // expected-note @+1 {{load it from a field or from an argument that is a memref of floats}}
  %2 = vector.bitcast %1 : vector<2xi32> to vector<2xf32>
  %3 = vector.extract %2[0] : f32 from vector<2xf32>
  memref.store %3, %y[] : memref<f32>
  return
}

// -----

func.func @moved(%p: memref<?xvector<2xi32>>, %y: memref<f32>, %c: i1) attributes {tai.differentiate} {
  %c0 = arith.constant 0 : index
  %0 = memref.load %p[%c0] : memref<?xvector<2xi32>>
  %1 = vector.shape_cast %0 : vector<2xi32> to vector<1x2xi32>
  %2 = vector.transpose %1, [1, 0] : vector<1x2xi32> to vector<2x1xi32>
  %3 = vector.extract %2[1, 0] : i32 from vector<2x1xi32>
  %4 = vector.broadcast %3 : i32 to vector<2xi32>
  %5 = vector.insert %3, %4[0] : i32 into vector<2xi32>
  %6:2 = vector.to_elements %5 : vector<2xi32>
  %7 = vector.from_elements %6#1, %6#0 : vector<2xi32>
  %8 = arith.select %c, %7, %5 : vector<2xi32>
  %9 = vector.extract_strided_slice %8 {offsets = [1], sizes = [1], strides = [1]} : vector<2xi32> to vector<1xi32>
  %10 = vector.extract %9[0] : i32 from vector<1xi32>
  %11 = builtin.unrealized_conversion_cast %10 : i32 to i32
  %12 = scf.if %c -> i32 {
    scf.yield %11 : i32
  } else {
    scf.yield %10 : i32
  }
  // expected-error @+2 {{'llvm.bitcast' reads floats from memory that derivatives are not followed through}}
  // expected-note @+1 {{load it from a field or from an argument that is a memref of floats}}
  %13 = llvm.bitcast %12 : i32 to f32
  memref.store %13, %y[] : memref<f32>
  return
}

// -----

func.func @of_tensors(%p: memref<?xi32>, %y: memref<f32>) attributes {tai.differentiate} {
  %c0 = arith.constant 0 : index
  %0 = memref.load %p[%c0] : memref<?xi32>
  %1 = tensor.from_elements %0, %0 : tensor<2xi32>
  // expected-error @+2 {{'tensor.bitcast' reads floats from memory that derivatives are not followed through}}
  // expected-note @+1 {{load it from a field or from an argument that is a memref of floats}}
  %2 = tensor.bitcast %1 : tensor<2xi32> to tensor<2xf32>
  %3 = tensor.extract %2[%c0] : tensor<2xf32>
  memref.store %3, %y[] : memref<f32>
  return
}

// -----

// Structures and arrays of LLVM hold floats too, and memory behind a cast
// pointer is that behind the pointer.
func.func @structures(%p: !llvm.ptr, %y: memref<f64>) attributes {tai.differentiate} {
  %q = llvm.addrspacecast %p : !llvm.ptr to !llvm.ptr<1>
  // expected-error @+2 {{'llvm.load' reads floats from memory that derivatives are not followed through}}
  // expected-note @+1 {{load it from a field}}
  %0 = llvm.load %q : !llvm.ptr<1> -> !llvm.struct<(i32, array<2 x f64>)>
  %1 = llvm.extractvalue %0[1, 0] : !llvm.struct<(i32, array<2 x f64>)>
  memref.store %1, %y[] : memref<f64>
  return
}

// -----

// A constant of the module has no derivative; a variable of it may hold
// anything.
llvm.mlir.global constant @table(2.0 : f64) : f64
llvm.mlir.global internal @state(2.0 : f64) : f64
func.func @globals(%x: memref<f64>, %y: memref<f64>) attributes {tai.differentiate} {
  %0 = memref.load %x[] : memref<f64>
  %1 = llvm.mlir.addressof @table : !llvm.ptr
  %2 = llvm.load %1 : !llvm.ptr -> f64
  %3 = arith.mulf %0, %2 : f64
  %4 = llvm.mlir.addressof @state : !llvm.ptr
  // expected-error @+2 {{'llvm.load' reads floats from memory that derivatives are not followed through}}
  // expected-note @+1 {{load it from a field}}
  %5 = llvm.load %4 : !llvm.ptr -> f64
  %6 = arith.mulf %3, %5 : f64
  memref.store %6, %y[] : memref<f64>
  return
}
