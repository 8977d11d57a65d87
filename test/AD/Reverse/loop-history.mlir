// RUN: tai-opt %s --tai-make-adjoint --canonicalize --cse | FileCheck %s
// RUN: tai-opt %s --tai-make-adjoint=history-bytes=100 --canonicalize --cse | FileCheck %s --check-prefix=TIGHT
// RUN: not tai-opt %s --tai-make-adjoint=history-bytes=little 2>&1 | FileCheck %s --check-prefix=INVALID

// INVALID: for the --history-bytes option: 'little' value invalid

// How the reverse of a loop gets the values that an iteration began with.

!t = !tai.root<dense<[i: 16], {x: f32, x_grad: f32, y: f32, y_grad: f32, n: i32}>>
tai.tree @t : !t
tai.field @x_grad = @t["x_grad"] : f32, rank 1
tai.field @y_grad = @t["y_grad"] : f32, rank 1
tai.field @x = @t["x"] : f32, rank 1, adjoint @x_grad
tai.field @y = @t["y"] : f32, rank 1, adjoint @y_grad
tai.field @n = @t["n"] : i32, rank 1

// A value whose history the gradient needs is recorded: the loop runs forward
// once more, without the sum that nobody needs, and the history is freed. There
// is room for all of 100 floats.
// CHECK-LABEL: tai.kernel @trajectory_grad()
//   CHECK-DAG:   %[[N:.+]] = arith.constant 100 : index
//   CHECK-DAG:   %[[LAST:.+]] = arith.constant 99 : index
//       CHECK:   tai.parallel_for
//       CHECK:     %[[X:.+]] = tai.load @x
//       CHECK:     %[[H:.+]] = memref.alloc() : memref<100xf32>
//   CHECK-NOT:     memref.alloc
//       CHECK:     scf.for %[[J:.+]] = %{{.+}} to %[[N]] step %{{.+}} iter_args(%[[V:.+]] = %[[X]]) -> (f32) {
//       CHECK:       memref.store %[[V]], %[[H]][%[[J]]]
//       CHECK:       math.sin
//   CHECK-NOT:       arith.addf
//       CHECK:       scf.yield
//       CHECK:     %[[G:.+]] = tai.load @y_grad
//       CHECK:     %[[GX:.+]] = scf.for %[[K:.+]] = %{{.+}} to %[[N]] step %{{.+}} iter_args(%[[GV:.+]] = %{{.+}})
//       CHECK:       %[[J2:.+]] = arith.subi %[[LAST]], %[[K]]
//       CHECK:       %[[V2:.+]] = memref.load %[[H]][%[[J2]]]
//       CHECK:       math.cos %[[V2]]
//       CHECK:       scf.yield
//       CHECK:     memref.dealloc %[[H]]
//       CHECK:     tai.atomic add %[[GX]], @x_grad

// In 100 bytes there is room for 25: four chunks, of which three are run again.
// TIGHT-LABEL: tai.kernel @trajectory_grad()
//   TIGHT-DAG:   %[[C25:.+]] = arith.constant 25 : index
//   TIGHT-DAG:   %[[C4:.+]] = arith.constant 4 : index
//       TIGHT:     %[[X:.+]] = tai.load @x
//       TIGHT:     %[[H:.+]] = memref.alloc() : memref<29xf32>
//   TIGHT-NOT:     memref.alloc
//       TIGHT:     scf.for %[[C:.+]] = %{{.+}} to %[[C4]] step %{{.+}} iter_args(%[[V:.+]] = %[[X]]) -> (f32) {
//       TIGHT:       %[[S:.+]] = arith.addi %[[C]], %[[C25]]
//       TIGHT:       memref.store %[[V]], %[[H]][%[[S]]]
//       TIGHT:       %[[BEGIN:.+]] = arith.muli %[[C]], %[[C25]]
//       TIGHT:       scf.for %[[J:.+]] = %[[BEGIN]] to %{{.+}} step %{{.+}} iter_args(%[[W:.+]] = %[[V]]) -> (f32) {
//       TIGHT:         %[[AT:.+]] = arith.subi %[[J]], %[[BEGIN]]
//       TIGHT:         memref.store %[[W]], %[[H]][%[[AT]]]
//       TIGHT:         math.sin
//       TIGHT:     scf.for %[[K:.+]] = %{{.+}} to %[[C4]] step %{{.+}} iter_args(%[[GV:.+]] = %{{.+}})
//       TIGHT:       %[[C2:.+]] = arith.subi %{{.+}}, %[[K]]
//       TIGHT:       %[[BEGIN2:.+]] = arith.muli %[[C2]], %[[C25]]
//       TIGHT:       %[[ISLAST:.+]] = arith.cmpi eq, %[[K]], %{{.+}}
//       TIGHT:       %[[END:.+]] = arith.select %[[ISLAST]], %[[BEGIN2]], %{{.+}}
//       TIGHT:       %[[S2:.+]] = arith.subi %{{.+}}, %[[K]]
//       TIGHT:       %[[START:.+]] = memref.load %[[H]][%[[S2]]]
//       TIGHT:       scf.for %{{.+}} = %[[BEGIN2]] to %[[END]] step %{{.+}} iter_args(%{{.+}} = %[[START]]) -> (f32) {
//       TIGHT:         memref.store %{{.+}}, %[[H]]
//       TIGHT:       scf.for %{{.+}} iter_args(%{{.+}} = %[[GV]]) -> (f32) {
//       TIGHT:         memref.load %[[H]]
//       TIGHT:         math.cos
//       TIGHT:     memref.dealloc %[[H]]
tai.kernel @trajectory() {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  %n = arith.constant 100 : index
  %zero = arith.constant 0.0 : f32
  tai.parallel_for (%i) in @x {
    %x = tai.load @x[%i] : f32
    %r:2 = scf.for %j = %c0 to %n step %c1 iter_args(%s = %zero, %v = %x) -> (f32, f32) {
      %w = math.sin %v : f32
      %t = arith.addf %s, %w : f32
      scf.yield %t, %w : f32, f32
    }
    tai.store %r#0, @y[%i] : f32
  }
  tai.return
}

// Where only the run knows the number of iterations, it chooses: one chunk while
// there is room (262144 bytes), of about the square root of the number beyond.
// CHECK-LABEL: tai.kernel @dynamic_grad(
//  CHECK-SAME:     %[[N:.+]]: index)
//   CHECK-DAG:   %[[ROOM:.+]] = arith.constant 65536 : index
//       CHECK:     %[[TRIPS:.+]] = arith.maxsi %[[N]], %{{.+}} : index
//       CHECK:     math.sqrt
//       CHECK:     math.ceil
//       CHECK:     %[[SIZE:.+]] = arith.maxsi %{{.+}}, %[[ROOM]] : index
//       CHECK:     arith.divf
//       CHECK:     %[[NUMBER:.+]] = arith.index_cast %{{.+}} : i64 to index
//       CHECK:     %[[USED:.+]] = arith.minsi %[[TRIPS]], %[[SIZE]] : index
//       CHECK:     %[[BOTH:.+]] = arith.addi %[[USED]], %[[NUMBER]]
//       CHECK:     memref.alloc(%[[BOTH]]) : memref<?xf32>
//       CHECK:     scf.for %{{.+}} = %{{.+}} to %[[NUMBER]] step
tai.kernel @dynamic(%n: index) {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  tai.parallel_for (%i) in @x {
    %x = tai.load @x[%i] : f32
    %r = scf.for %j = %c0 to %n step %c1 iter_args(%v = %x) -> (f32) {
      %w = math.sin %v : f32
      scf.yield %w : f32
    }
    tai.store %r, @y[%i] : f32
  }
  tai.return
}

// Bounds of another type, a start and a step: chunks are ranges of them.
// TIGHT-LABEL: tai.kernel @bounds_grad(
//  TIGHT-SAME:     %[[A:.+]]: i32, %[[B:.+]]: i32)
//   TIGHT-DAG:   %[[C3:.+]] = arith.constant 3 : i32
//       TIGHT:     %[[BEGIN:.+]] = arith.muli
//       TIGHT:     %[[AT:.+]] = arith.index_cast %[[BEGIN]] : index to i32
//       TIGHT:     %[[SCALED:.+]] = arith.muli %[[AT]], %[[C3]]
//       TIGHT:     %[[LOWER:.+]] = arith.addi %[[A]], %[[SCALED]]
//       TIGHT:     %[[UPPER:.+]] = arith.select %{{.+}}, %[[B]], %{{.+}} : i32
//       TIGHT:     scf.for %[[J:.+]] = %[[LOWER]] to %[[UPPER]] step %[[C3]] iter_args({{.*}}) -> (f32) : i32 {
//       TIGHT:       %[[DIFF:.+]] = arith.subi %[[J]], %[[LOWER]] : i32
//       TIGHT:       arith.divui %[[DIFF]], %[[C3]]
tai.kernel @bounds(%a: i32, %b: i32) {
  %c3 = arith.constant 3 : i32
  tai.parallel_for (%i) in @x {
    %x = tai.load @x[%i] : f32
    %r = scf.for %j = %a to %b step %c3 iter_args(%v = %x) -> (f32) : i32 {
      %w = math.sin %v : f32
      scf.yield %w : f32
    }
    tai.store %r, @y[%i] : f32
  }
  tai.return
}

// Formulas of the number of the iteration are computed, without a history and
// without a second run of the loop.
// CHECK-LABEL: tai.kernel @closed_form_grad(
//   CHECK-DAG:   %[[C2:.+]] = arith.constant 2 : i32
//   CHECK-DAG:   %[[C5:.+]] = arith.constant 5 : i32
//   CHECK-NOT:   memref.alloc
//       CHECK:   scf.for %[[K:[a-z0-9]+]] =
//       CHECK:     %[[J:.+]] = arith.subi %{{.+}}, %[[K]]
//       CHECK:     arith.andi %[[J]], %{{.+}} : index
//       CHECK:     arith.xori
//       CHECK:     %[[I:.+]] = arith.index_cast %[[J]] : index to i32
//       CHECK:     %[[TWICE:.+]] = arith.muli %[[I]], %[[C2]]
//       CHECK:     arith.addi %[[TWICE]], %[[C5]]
//   CHECK-NOT:   scf.for
//       CHECK: tai.return
tai.kernel @closed_form(%n: index) {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  %c2 = arith.constant 2 : i32
  %c5 = arith.constant 5 : i32
  %c7 = arith.constant 7 : i32
  %zero = arith.constant 0.0 : f32
  tai.parallel_for (%i) in @x {
    %x = tai.load @x[%i] : f32
    %r:3 = scf.for %j = %c0 to %n step %c1 iter_args(%s = %zero, %a = %c5, %b = %c2) -> (f32, i32, i32) {
      %f = arith.sitofp %a : i32 to f32
      %g = arith.sitofp %b : i32 to f32
      %p = arith.mulf %f, %g : f32
      %q = arith.mulf %p, %x : f32
      %t = arith.addf %s, %q : f32
      %a1 = arith.addi %a, %c2 : i32
      %b1 = arith.xori %b, %c7 : i32
      scf.yield %t, %a1, %b1 : f32, i32, i32
    }
    tai.store %r#0, @y[%i] : f32
  }
  tai.return
}

// An update with an exact inverse: the value goes backwards with the loop, from
// the result of the loop. 3 has the inverse 2863311531 modulo 2^32.
// CHECK-LABEL: tai.kernel @invertible_grad(
//   CHECK-DAG:   %[[INV:.+]] = arith.constant -1431655765 : i32
//   CHECK-NOT:   memref.alloc
//       CHECK:   %[[END:.+]] = scf.for %{{.+}} iter_args({{.*}}) -> (i32) {
//       CHECK:   scf.for %{{.+}} iter_args(%[[NEXT:[a-z0-9]+]] = %[[END]], %{{.+}}) -> (i32, f32) {
//       CHECK:     %[[LESS:.+]] = arith.subi %[[NEXT]], %{{.+}} : i32
//       CHECK:     %[[A:.+]] = arith.muli %[[LESS]], %[[INV]] : i32
//       CHECK:     scf.yield %[[A]], %{{.+}} : i32, f32
tai.kernel @invertible(%n: index) {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  %c3 = arith.constant 3 : i32
  %zero = arith.constant 0.0 : f32
  tai.parallel_for (%i) in @x {
    %x = tai.load @x[%i] : f32
    %r:2 = scf.for %j = %c0 to %n step %c1 iter_args(%s = %zero, %a = %c3) -> (f32, i32) {
      %f = arith.sitofp %a : i32 to f32
      %q = arith.mulf %f, %x : f32
      %t = arith.addf %s, %q : f32
      %k = arith.index_cast %j : index to i32
      %m = arith.muli %a, %c3 : i32
      %a1 = arith.addi %m, %k : i32
      scf.yield %t, %a1 : f32, i32
    }
    tai.store %r#0, @y[%i] : f32
  }
  tai.return
}

// A sum of floats gives no value back exactly: it is recorded. So is an integer
// that is multiplied by an even number, or whose change depends on itself.
// CHECK-LABEL: tai.kernel @not_invertible_grad(
//   CHECK-DAG:   memref.alloc() : memref<8xf32>
//   CHECK-DAG:   memref.alloc() : memref<8xi32>
//   CHECK-DAG:   memref.alloc() : memref<8xi32>
tai.kernel @not_invertible() {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  %c8 = arith.constant 8 : index
  %c6 = arith.constant 6 : i32
  %c3 = arith.constant 3 : i32
  tai.parallel_for (%i) in @x {
    %x = tai.load @x[%i] : f32
    %r:3 = scf.for %j = %c0 to %c8 step %c1 iter_args(%s = %x, %a = %c3, %b = %c3) -> (f32, i32, i32) {
      %f = arith.sitofp %a : i32 to f32
      %g = arith.sitofp %b : i32 to f32
      %p = arith.mulf %f, %s : f32
      %q = arith.mulf %p, %g : f32
      %v = math.sin %q : f32
      %t = arith.addf %s, %v : f32
      %a1 = arith.muli %a, %c6 : i32
      %h = arith.shrui %b, %c3 : i32
      %b1 = arith.xori %b, %h : i32
      scf.yield %t, %a1, %b1 : f32, i32, i32
    }
    tai.store %r#0, @y[%i] : f32
  }
  tai.return
}

// Two floats that take turns need one record.
// CHECK-LABEL: tai.kernel @turns_grad(
//       CHECK:   memref.alloc() : memref<8xf32>
//   CHECK-NOT:   memref.alloc
//       CHECK: tai.return
tai.kernel @turns() {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  %c8 = arith.constant 8 : index
  tai.parallel_for (%i) in @x {
    %x = tai.load @x[%i] : f32
    %r:2 = scf.for %j = %c0 to %c8 step %c1 iter_args(%a = %x, %b = %x) -> (f32, f32) {
      %p = arith.mulf %a, %b : f32
      scf.yield %b, %p : f32, f32
    }
    tai.store %r#1, @y[%i] : f32
  }
  tai.return
}

// A while loop that carries a derivative runs once to count, once to record, as
// a loop of that many iterations, and then backwards. The last condition passed
// on the result: it is reversed first. The sum that nothing needs is not run.
// CHECK-LABEL: tai.kernel @newton_grad(
//       CHECK:     %[[X:.+]] = tai.load @x
//       CHECK:     %[[G:.+]] = tai.load @y_grad
//       CHECK:     %[[COUNT:.+]]:2 = scf.while (%{{.+}} = %[[X]], %{{.+}} = %{{.+}}) : (f32, index) -> (f32, index)
//   CHECK-NOT:       arith.addf
//   CHECK-NOT:     scf.while
//       CHECK:     %[[LONG:.+]] = arith.cmpi sgt
//       CHECK:     scf.if %[[LONG]] -> (index, index) {
//       CHECK:       math.sqrt
//       CHECK:     } else {
//       CHECK:     %[[H:.+]] = memref.alloc(%{{.+}}) : memref<?xf32>
//   CHECK-NOT:     scf.while
//       CHECK:     scf.for
//       CHECK:       scf.for
//       CHECK:         memref.store %{{.+}}, %[[H]]
//       CHECK:     %[[GX:.+]] = scf.for %{{.+}} iter_args(%{{.+}} = %[[G]]) -> (f32) {
//       CHECK:         memref.store %{{.+}}, %[[H]]
//       CHECK:         memref.load %[[H]]
//       CHECK:     memref.dealloc %[[H]]
//       CHECK:     tai.atomic add %[[GX]], @x_grad
tai.kernel @newton(%limit: f32) {
  tai.parallel_for (%i) in @x {
    %x = tai.load @x[%i] : f32
    %r:2 = scf.while (%v = %x, %sum = %x) : (f32, f32) -> (f32, f32) {
      %more = arith.cmpf ogt, %v, %limit : f32
      scf.condition(%more) %v, %sum : f32, f32
    } do {
    ^bb0(%v: f32, %sum: f32):
      %s = math.sin %v : f32
      %t = arith.addf %sum, %s : f32
      scf.yield %s, %t : f32, f32
    }
    tai.store %r#0, @y[%i] : f32
  }
  tai.return
}

// A chunk begins with all that its record depends on: %b decides the next %v
// although no rule asks for it.
// TIGHT-LABEL: tai.kernel @closure_grad(
//       TIGHT:   memref.alloc() : memref<33xf32>
//       TIGHT:   memref.alloc() : memref<8xi1>
//   TIGHT-NOT:   memref.alloc
//       TIGHT: tai.return
tai.kernel @closure() {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  %n = arith.constant 200 : index
  %zero = arith.constant 0.0 : f32
  %true = arith.constant true
  tai.parallel_for (%i) in @x {
    %x = tai.load @x[%i] : f32
    %r:3 = scf.for %j = %c0 to %n step %c1 iter_args(%v = %x, %b = %true, %sum = %zero) -> (f32, i1, f32) {
      %square = arith.mulf %v, %v : f32
      %k = arith.uitofp %b : i1 to f32
      %w = arith.addf %square, %k : f32
      %small = arith.cmpf olt, %v, %x : f32
      %b1 = arith.andi %b, %small : i1
      %t = arith.addf %sum, %w : f32
      scf.yield %w, %b1, %t : f32, i1, f32
    }
    tai.store %r#0, @y[%i] : f32
  }
  tai.return
}

// A counter of a while loop names another element in each iteration, so that the
// values before the kernel are those of its reads; other numbers may come again.
tai.tree @w : !tai.root<dense<[i: 8], {wx: f64, wgx: f64, wy: f64, wgy: f64}>>
tai.field @wx = @w["wx"] : f64, rank 1, adjoint @wgx
tai.field @wgx = @w["wgx"] : f64, rank 1
tai.field @wy = @w["wy"] : f64, rank 1, adjoint @wgy
tai.field @wgy = @w["wgy"] : f64, rank 1

// CHECK-LABEL: tai.kernel @counter_grad(%{{.+}}: index) attributes {reads_before = [@wx]} {
//   CHECK-NOT:   tai.stack_push
//       CHECK:   tai.return
tai.kernel @counter(%n: index) {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  %e = scf.while (%k = %c0) : (index) -> index {
    %go = arith.cmpi slt, %k, %n : index
    scf.condition(%go) %k : index
  } do {
  ^bb0(%k: index):
    %0 = tai.load @wx[%k] : f64
    %1 = math.sin %0 : f64
    tai.store %1, @wx[%k] : f64
    %next = arith.addi %k, %c1 : index
    scf.yield %next : index
  }
  tai.return
}

// CHECK-LABEL: tai.kernel @square_grad(%{{.+}}: index) attributes {reads_before = [@wx], reexecutes} {
//       CHECK:   tai.stack_push
//       CHECK:   tai.return
tai.kernel @square(%n: index) {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  %e = scf.while (%k = %c0) : (index) -> index {
    %go = arith.cmpi slt, %k, %n : index
    scf.condition(%go) %k : index
  } do {
  ^bb0(%k: index):
    %0 = tai.load @wx[%k] : f64
    %1 = math.sin %0 : f64
    tai.store %1, @wx[%k] : f64
    %next = arith.muli %k, %k : index
    scf.yield %next : index
  }
  tai.return
}
