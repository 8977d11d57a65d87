// RUN: tai-opt %s --tai-make-adjoint --canonicalize --cse | FileCheck %s

// Iterations that are run again have memory of their own.

!t = !tai.root<dense<[i: 16], {x: f64, gx: f64, y: f64, gy: f64, n: i32, c: i32}>, {a: f64, ga: f64}>
tai.tree @t : !t
tai.field @gx = @t["gx"] : f64, rank 1
tai.field @gy = @t["gy"] : f64, rank 1
tai.field @ga = @t["ga"] : f64, rank 0
tai.field @x = @t["x"] : f64, rank 1, adjoint @gx
tai.field @y = @t["y"] : f64, rank 1, adjoint @gy
tai.field @a = @t["a"] : f64, rank 0, adjoint @ga
tai.field @n = @t["n"] : i32, rank 1
tai.field @c = @t["c"] : i32, rank 1

// The iteration makes its list again, and gives it back.
// CHECK-LABEL: tai.kernel @list_grad()
//       CHECK:   tai.parallel_for
//       CHECK:     %[[M:.+]] = memref.alloc() : memref<2xi32>
//       CHECK:     memref.store %{{.+}}, %[[M]]
//       CHECK:     memref.load %[[M]]
//       CHECK:     memref.dealloc %[[M]]
//       CHECK:     tai.store %{{.+}}, @x
//   CHECK-NOT:     memref.
//       CHECK:   tai.return
// CHECK-LABEL: tai.kernel @stack_list_grad()
//       CHECK:     %[[M:.+]] = memref.alloca() : memref<2xi32>
//       CHECK:     memref.store %{{.+}}, %[[M]]
//       CHECK:     tai.store %{{.+}}, @x
//       CHECK:   tai.return
tai.kernel @list() {
  %c1 = arith.constant 1 : index
  tai.parallel_for (%i) in @x {
    %m = memref.alloc() : memref<2xi32>
    %k = tai.load @n[%i] : i32
    memref.store %k, %m[%c1] : memref<2xi32>
    %h = memref.load %m[%c1] : memref<2xi32>
    memref.dealloc %m : memref<2xi32>
    %j = arith.sitofp %h : i32 to f64
    %0 = tai.load @x[%i] : f64
    %1 = math.sin %0 : f64
    %2 = arith.addf %1, %j : f64
    tai.store %2, @x[%i] : f64
    %3 = tai.load @x[%i] : f64
    %5 = math.sin %3 : f64
    tai.store %5, @x[%i] : f64
  }
  tai.return
}
tai.kernel @stack_list() {
  %c1 = arith.constant 1 : index
  tai.parallel_for (%i) in @x {
    %m = memref.alloca() : memref<2xi32>
    %k = tai.load @n[%i] : i32
    memref.store %k, %m[%c1] : memref<2xi32>
    %h = memref.load %m[%c1] : memref<2xi32>
    %j = arith.sitofp %h : i32 to f64
    %0 = tai.load @x[%i] : f64
    %1 = math.sin %0 : f64
    %2 = arith.addf %1, %j : f64
    tai.store %2, @x[%i] : f64
    %3 = tai.load @x[%i] : f64
    %5 = math.sin %3 : f64
    tai.store %5, @x[%i] : f64
  }
  tai.return
}
