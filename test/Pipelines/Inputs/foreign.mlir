// A module of other compilers, with all that a general pass would rewrite: dead
// code, constants that fold, equal values, calls of private functions, loops
// that unroll, branches that flatten, allocations that move.

#row = affine_map<(d0, d1) -> (d0, d1)>
#half = affine_map<(d0) -> (d0 floordiv 2)>
module attributes {dlti.dl_spec = #dlti.dl_spec<index = 64 : i32>, gpu.container_module} {
  memref.global "private" constant @table : memref<4xf32> = dense<[1.0, 2.0, 3.0, 4.0]>
  llvm.mlir.global internal constant @text("hello\00")
  llvm.func @malloc(i64) -> !llvm.ptr
  llvm.func @free(!llvm.ptr)
  llvm.func @use(!llvm.ptr)

  func.func private @mine(%a: f32) -> f32 {
    return %a : f32
  }
  func.func private @external(memref<?xf32>) -> vector<4xf32>
  func.func private @down(%n: i64) -> i64 {
    %0 = func.call @down(%n) : (i64) -> i64
    return %0 : i64
  }
  func.func private @helper(%a: f64, %b: f64) -> f64 {
    %0 = arith.addf %a, %b : f64
    return %0 : f64
  }
  func.func @folds(%a: f64, %i: index) -> (f64, f64, index) {
    %one = arith.constant 1.0 : f64
    %zero = arith.constant 0.0 : f64
    %dead = arith.mulf %a, %a : f64
    %x = arith.mulf %a, %one : f64
    %y = arith.mulf %a, %one : f64
    %s = arith.addf %x, %y : f64
    %r = func.call @helper(%s, %one) : (f64, f64) -> f64
    %angle = math.atan2 %zero, %one : f64
    %narrow = arith.index_cast %i : index to i32
    %wide = arith.index_cast %narrow : i32 to index
    return %r, %angle, %wide : f64, f64, index
  }
  func.func @pointer() -> ((f64, f64) -> f64) {
    %0 = func.constant @helper : (f64, f64) -> f64
    return %0 : (f64, f64) -> f64
  }
  func.func @blocks(%c: i1, %a: f64) -> f64 {
    cf.cond_br %c, ^one, ^two
  ^one:
    return %a : f64
  ^two:
    %0 = arith.negf %a : f64
    cf.br ^three(%0 : f64)
  ^three(%1: f64):
    return %1 : f64
  }
  func.func @branches(%c: i1, %a: f32, %b: f32, %n: i32) -> (f32, i32) {
    %0 = scf.if %c -> f32 {
      %1 = arith.addf %a, %b : f32
      scf.yield %1 : f32
    } else {
      scf.yield %a : f32
    }
    %two = arith.constant 2 : i32
    %q = arith.divsi %n, %two : i32
    %r = arith.remsi %n, %q : i32
    return %0, %r : f32, i32
  }
  func.func @switch(%i: index) -> i32 {
    %c1 = arith.constant 1 : i32
    %0 = scf.index_switch %i -> i32
    case 2 {
      scf.yield %c1 : i32
    }
    default {
      %c5 = arith.constant 5 : i32
      scf.yield %c5 : i32
    }
    %1 = scf.execute_region -> i32 {
      scf.yield %0 : i32
    }
    return %1 : i32
  }
  func.func @sums(%m: memref<?xf32>, %p: !llvm.ptr, %n: index) {
    %c0 = arith.constant 0 : index
    %c1 = arith.constant 1 : index
    %c4 = arith.constant 4 : index
    %zero = arith.constant 0.0 : f32
    scf.for %i = %c0 to %n step %c1 {
      %s = scf.for %j = %c0 to %c4 step %c1 iter_args(%acc = %zero) -> f32 {
        %k = arith.addi %i, %j : index
        %near = arith.cmpi slt, %k, %n : index
        %v = scf.if %near -> f32 {
          %w = memref.load %m[%k] : memref<?xf32>
          scf.yield %w : f32
        } else {
          scf.yield %zero : f32
        }
        %t = arith.addf %acc, %v : f32
        scf.yield %t : f32
      }
      memref.store %s, %m[%i] : memref<?xf32>
      %g = llvm.getelementptr %p[4] : (!llvm.ptr) -> !llvm.ptr, f32
      llvm.store %s, %g : f32, !llvm.ptr
    }
    return
  }
  func.func @allocations(%n: i64, %from: index, %to: index, %step: index) {
    scf.for %i = %from to %to step %step {
      %size = llvm.mul %n, %n : i64
      %p = llvm.call @malloc(%size) : (i64) -> !llvm.ptr
      llvm.call @use(%p) : (!llvm.ptr) -> ()
      llvm.call @free(%p) : (!llvm.ptr) -> ()
      %b = memref.alloc() : memref<8xf32>
      memref.dealloc %b : memref<8xf32>
    }
    return
  }
  func.func @parallel(%m: memref<?x?xf32>, %n: index) -> f32 {
    %c0 = arith.constant 0 : index
    %c1 = arith.constant 1 : index
    %zero = arith.constant 0.0 : f32
    %sum = scf.parallel (%i, %j) = (%c0, %c0) to (%n, %n) step (%c1, %c1) init (%zero) -> f32 {
      %v = memref.load %m[%i, %j] : memref<?x?xf32>
      scf.reduce(%v : f32) {
      ^bb0(%a: f32, %b: f32):
        %s = arith.addf %a, %b : f32
        scf.reduce.return %s : f32
      }
    }
    scf.forall (%i) in (%n) {
      memref.store %sum, %m[%i, %c0] : memref<?x?xf32>
    }
    return %sum : f32
  }
  func.func @view(%m: memref<16xf32>) -> memref<2x2xf32, strided<[4, 1], offset: ?>> {
    %c0 = arith.constant 0 : index
    %e = memref.expand_shape %m [[0, 1]] output_shape [4, 4] : memref<16xf32> into memref<4x4xf32>
    %s = memref.subview %e[%c0, 0] [2, 2] [1, 1] : memref<4x4xf32> to memref<2x2xf32, strided<[4, 1], offset: ?>>
    %t = memref.get_global @table : memref<4xf32>
    %a = memref.alloca() : memref<4xf32>
    memref.copy %t, %a : memref<4xf32> to memref<4xf32>
    return %s : memref<2x2xf32, strided<[4, 1], offset: ?>>
  }
  func.func @affine(%m: memref<64xf32>) {
    affine.for %i = 0 to 64 {
      %h = affine.apply #half(%i)
      %v = affine.load %m[%h] : memref<64xf32>
      affine.store %v, %m[%i] : memref<64xf32>
    }
    return
  }
  func.func @linalg(%a: tensor<4x4xf32>, %b: tensor<4x4xf32>) -> tensor<4x4xf32> {
    %empty = tensor.empty() : tensor<4x4xf32>
    %zero = arith.constant 0.0 : f32
    %fill = linalg.fill ins(%zero : f32) outs(%empty : tensor<4x4xf32>) -> tensor<4x4xf32>
    %c = linalg.matmul ins(%a, %b : tensor<4x4xf32>, tensor<4x4xf32>) outs(%fill : tensor<4x4xf32>) -> tensor<4x4xf32>
    %d = linalg.generic {indexing_maps = [#row, #row], iterator_types = ["parallel", "parallel"]}
        ins(%c : tensor<4x4xf32>) outs(%empty : tensor<4x4xf32>) {
    ^bb0(%in: f32, %out: f32):
      %e = math.exp %in : f32
      linalg.yield %e : f32
    } -> tensor<4x4xf32>
    return %d : tensor<4x4xf32>
  }
  func.func @vectors(%m: memref<?xf32>, %v: vector<4xf32>, %i: index) -> (f32, vector<4xf32>) {
    %zero = arith.constant 0.0 : f32
    %w = vector.transfer_read %m[%i], %zero : memref<?xf32>, vector<4xf32>
    %s = arith.addf %v, %w : vector<4xf32>
    %e = vector.extract %s[%i] : f32 from vector<4xf32>
    %u = vector.insert %e, %s[%i] : f32 into vector<4xf32>
    %r = vector.reduction <add>, %u : vector<4xf32> into f32
    return %r, %u : f32, vector<4xf32>
  }
  func.func @launches(%m: memref<?xf32>, %n: index) {
    %c1 = arith.constant 1 : index
    gpu.launch_func @kernels::@kernel blocks in (%n, %c1, %c1) threads in (%c1, %c1, %c1) args(%m : memref<?xf32>)
    gpu.launch blocks(%bx, %by, %bz) in (%gx = %n, %gy = %c1, %gz = %c1)
               threads(%tx, %ty, %tz) in (%sx = %c1, %sy = %c1, %sz = %c1) {
      gpu.terminator
    }
    return
  }
  gpu.module @kernels {
    gpu.func @kernel(%m: memref<?xf32>) kernel {
      %i = gpu.block_id x
      %v = memref.load %m[%i] : memref<?xf32>
      %d = arith.addf %v, %v : f32
      memref.store %d, %m[%i] : memref<?xf32>
      gpu.return
    }
    llvm.func @device(%a: f32) -> f32 {
      %0 = math.exp %a : f32
      llvm.return %0 : f32
    }
  }
  llvm.func @plain(%p: !llvm.ptr, %a: f32, %n: i64) -> f64 {
    %0 = arith.addf %a, %a : f32
    %1 = math.sin %0 : f32
    %2 = llvm.fpext %1 : f32 to f64
    %3 = llvm.fadd %2, %2 : f64
    llvm.store %3, %p : f64, !llvm.ptr
    %c0 = arith.constant 0 : i64
    %c1 = arith.constant 1 : i64
    scf.for %i = %c0 to %n step %c1 : i64 {
      llvm.store %3, %p : f64, !llvm.ptr
    }
    llvm.return %3 : f64
  }
  module @inner {
    func.func @folds(%a: f64) -> f64 {
      %one = arith.constant 1.0 : f64
      %0 = arith.mulf %a, %one : f64
      return %0 : f64
    }
    func.func private @unused(%a: f64) -> f64 {
      return %a : f64
    }
  }
  "other.op"() ({
    %0 = "other.value"() : () -> i32
  }) {sym_name = "unregistered"} : () -> ()
}
