// RUN: tai-opt %s --tai-hoist-allocations | FileCheck %s

llvm.func @malloc(i64) -> !llvm.ptr
llvm.func @free(!llvm.ptr)
llvm.func @use(!llvm.ptr)

// Memory of a size that does not change serves all iterations; the size is
// computed first.
// CHECK-LABEL: func.func @same_size(
//       CHECK:   %[[SIZE:.+]] = llvm.mul
//       CHECK:   %[[P:.+]] = llvm.call @malloc(%[[SIZE]])
//       CHECK:   scf.for
//   CHECK-NOT:     malloc
//       CHECK:     llvm.call @use(%[[P]])
//   CHECK-NOT:     free
//       CHECK:   }
//  CHECK-NEXT:   llvm.call @free(%[[P]])
func.func @same_size(%n: i64, %from: index, %to: index, %step: index) attributes {passthrough = ["tai.lowered"]} {
  %eight = llvm.mlir.constant(8 : i64) : i64
  scf.for %i = %from to %to step %step {
    %size = llvm.mul %n, %eight : i64
    %p = llvm.call @malloc(%size) : (i64) -> !llvm.ptr
    llvm.call @use(%p) : (!llvm.ptr) -> ()
    llvm.call @free(%p) : (!llvm.ptr) -> ()
  }
  return
}

// Out of an inner loop and then out of the outer one.
// CHECK-LABEL: func.func @nested(
//       CHECK:   llvm.call @malloc
//       CHECK:   scf.for
//       CHECK:     scf.for
//       CHECK:       llvm.call @use
//       CHECK:   llvm.call @free
//  CHECK-NEXT:   return
func.func @nested(%n: i64, %from: index, %to: index, %step: index) attributes {passthrough = ["tai.lowered"]} {
  scf.for %i = %from to %to step %step {
    scf.for %j = %from to %to step %step {
      %p = llvm.call @malloc(%n) : (i64) -> !llvm.ptr
      llvm.call @use(%p) : (!llvm.ptr) -> ()
      llvm.call @free(%p) : (!llvm.ptr) -> ()
    }
  }
  return
}

// These stay: memory of another size in each iteration, memory that lives on,
// and memory that only some iterations free.
// CHECK-LABEL: func.func @stays(
//       CHECK:   scf.for
// CHECK-COUNT-3: llvm.call @malloc
//       CHECK:   return
func.func @stays(%n: i64, %from: index, %to: index, %step: index, %c: i1) attributes {passthrough = ["tai.lowered"]} {
  scf.for %i = %from to %to step %step {
    %size = arith.index_cast %i : index to i64
    %p = llvm.call @malloc(%size) : (i64) -> !llvm.ptr
    llvm.call @use(%p) : (!llvm.ptr) -> ()
    llvm.call @free(%p) : (!llvm.ptr) -> ()
    %q = llvm.call @malloc(%n) : (i64) -> !llvm.ptr
    llvm.call @use(%q) : (!llvm.ptr) -> ()
    %r = llvm.call @malloc(%n) : (i64) -> !llvm.ptr
    scf.if %c {
      llvm.call @free(%r) : (!llvm.ptr) -> ()
    }
  }
  return
}
