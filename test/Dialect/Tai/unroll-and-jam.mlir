// RUN: tai-opt %s --tai-unroll-and-jam --split-input-file | FileCheck %s
// RUN: tai-opt %s --tai-unroll-and-jam=reassociate --split-input-file | FileCheck %s --check-prefix=ANY

#group = #llvm.access_group<id = distinct[0]<>>
#parallel = #llvm.loop_annotation<parallelAccesses = #group>

// A sum of 1000 terms in f64: few ops, so two vectors of four. What does not
// depend on the iteration is computed once.
// Where any order will do, LLVM makes vectors of terms of one sum.
// ANY-LABEL: func.func @sums(
//   ANY-NOT:   arith.andi
// CHECK-LABEL: func.func @sums(
//  CHECK-SAME:     %{{.+}}: !llvm.ptr, %{{.+}}: !llvm.ptr, %[[LO:.+]]: index, %[[HI:.+]]: index
//       CHECK:   %[[N:.+]] = arith.subi %[[HI]], %[[LO]]
//       CHECK:   %[[COUNT:.+]] = arith.maxsi %[[N]]
//       CHECK:   %[[WHOLE:.+]] = arith.andi %[[COUNT]], %c-8
//       CHECK:   %[[MIDDLE:.+]] = arith.addi %[[LO]], %[[WHOLE]]
//       CHECK:   scf.for %{{.+}} = %[[LO]] to %[[MIDDLE]] step %c8
//       CHECK:     %[[SUMS:.+]]:8 = scf.for
//       CHECK:       llvm.load
//   CHECK-NOT:       math.exp
// CHECK-COUNT-8:     arith.addf
//   CHECK-NOT:       arith.addf
//       CHECK:       scf.yield
// CHECK-COUNT-8:   llvm.store
//       CHECK:   scf.for %{{.+}} = %[[MIDDLE]] to %[[HI]] step
//       CHECK:     scf.for
//       CHECK:       arith.addf
//       CHECK:   } {llvm.loop_annotation
func.func @sums(%a: !llvm.ptr, %b: !llvm.ptr, %lo: index, %hi: index) {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  %c1000 = arith.constant 1000 : index
  %zero = arith.constant 0.0 : f64
  scf.for %i = %lo to %hi step %c1 {
    %i64 = arith.index_cast %i : index to i64
    %sum = scf.for %j = %c0 to %c1000 step %c1 iter_args(%s = %zero) -> (f64) {
      %j64 = arith.index_cast %j : index to i64
      %p = llvm.getelementptr %a[%j64] : (!llvm.ptr, i64) -> !llvm.ptr, f64
      %t = llvm.load %p {access_groups = [#group]} : !llvm.ptr -> f64
      %u = arith.addf %s, %t : f64
      scf.yield %u : f64
    }
    %q = llvm.getelementptr %b[%i64] : (!llvm.ptr, i64) -> !llvm.ptr, f64
    llvm.store %sum, %q {access_groups = [#group]} : f64, !llvm.ptr
  } {llvm.loop_annotation = #parallel}
  return
}

// -----

#group = #llvm.access_group<id = distinct[0]<>>
#other = #llvm.access_group<id = distinct[1]<>>
#parallel = #llvm.loop_annotation<parallelAccesses = #group>

// None of these is unrolled: a short sum, which LLVM unrolls; an access of another
// group; one of none; a bound that is the iteration's own; a call; no
// annotation; a loop that carries no sum.
// CHECK-LABEL: func.func @left(
//   CHECK-NOT:   arith.andi
//       CHECK:   return
func.func @left(%a: !llvm.ptr, %lo: index, %hi: index) {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  %c20 = arith.constant 20 : index
  %c1000 = arith.constant 1000 : index
  %zero = arith.constant 0.0 : f32
  scf.for %i = %lo to %hi step %c1 {
    %sum = scf.for %j = %c0 to %c20 step %c1 iter_args(%s = %zero) -> (f32) {
      %t = llvm.load %a {access_groups = [#group]} : !llvm.ptr -> f32
      %u = arith.addf %s, %t : f32
      scf.yield %u : f32
    }
    llvm.store %sum, %a {access_groups = [#group]} : f32, !llvm.ptr
  } {llvm.loop_annotation = #parallel}
  scf.for %i = %lo to %hi step %c1 {
    %sum = scf.for %j = %c0 to %c1000 step %c1 iter_args(%s = %zero) -> (f32) {
      %t = llvm.load %a {access_groups = [#other]} : !llvm.ptr -> f32
      %u = arith.addf %s, %t : f32
      scf.yield %u : f32
    }
  } {llvm.loop_annotation = #parallel}
  scf.for %i = %lo to %hi step %c1 {
    %sum = scf.for %j = %c0 to %c1000 step %c1 iter_args(%s = %zero) -> (f32) {
      %t = llvm.load %a : !llvm.ptr -> f32
      %u = arith.addf %s, %t : f32
      scf.yield %u : f32
    }
  } {llvm.loop_annotation = #parallel}
  scf.for %i = %lo to %hi step %c1 {
    %sum = scf.for %j = %c0 to %i step %c1 iter_args(%s = %zero) -> (f32) {
      %t = llvm.load %a {access_groups = [#group]} : !llvm.ptr -> f32
      %u = arith.addf %s, %t : f32
      scf.yield %u : f32
    }
  } {llvm.loop_annotation = #parallel}
  scf.for %i = %lo to %hi step %c1 {
    %sum = scf.for %j = %c0 to %c1000 step %c1 iter_args(%s = %zero) -> (f32) {
      %t = llvm.call @term() : () -> f32
      %u = arith.addf %s, %t : f32
      scf.yield %u : f32
    }
  } {llvm.loop_annotation = #parallel}
  scf.for %i = %lo to %hi step %c1 {
    %sum = scf.for %j = %c0 to %c1000 step %c1 iter_args(%s = %zero) -> (f32) {
      %t = llvm.load %a {access_groups = [#group]} : !llvm.ptr -> f32
      %u = arith.addf %s, %t : f32
      scf.yield %u : f32
    }
  }
  scf.for %i = %lo to %hi step %c1 {
    scf.for %j = %c0 to %c1000 step %c1 {
      llvm.store %zero, %a {access_groups = [#group]} : f32, !llvm.ptr
    }
  } {llvm.loop_annotation = #parallel}
  return
}
llvm.func @term() -> f32

// -----

#group = #llvm.access_group<id = distinct[0]<>>
#parallel = #llvm.loop_annotation<parallelAccesses = #group>

// Two levels; the inner bounds are the same in all iterations of the outermost.
// CHECK-LABEL: func.func @nested(
//       CHECK:   scf.for %{{.+}} = %{{.+}} to %{{.+}} step %c16
//       CHECK:     scf.for %{{.+}} iter_args({{.+}}) -> (f32, f32, f32, f32, f32, f32, f32, f32, f32, f32, f32, f32, f32, f32, f32, f32) {
//       CHECK:       scf.for %{{.+}} iter_args({{.+}}) -> (f32, f32, f32, f32, f32, f32, f32, f32, f32, f32, f32, f32, f32, f32, f32, f32) {
func.func @nested(%a: !llvm.ptr, %lo: index, %hi: index, %n: index) {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  %zero = arith.constant 0.0 : f32
  scf.for %i = %lo to %hi step %c1 {
    %i64 = arith.index_cast %i : index to i64
    %sum = scf.for %j = %c0 to %n step %c1 iter_args(%s = %zero) -> (f32) {
      %part = scf.for %k = %c0 to %n step %c1 iter_args(%r = %s) -> (f32) {
        %k64 = arith.index_cast %k : index to i64
        %p = llvm.getelementptr %a[%k64] : (!llvm.ptr, i64) -> !llvm.ptr, f32
        %t = llvm.load %p {access_groups = [#group]} : !llvm.ptr -> f32
        %u = arith.addf %r, %t : f32
        scf.yield %u : f32
      }
      scf.yield %part : f32
    }
    %q = llvm.getelementptr %a[%i64] : (!llvm.ptr, i64) -> !llvm.ptr, f32
    llvm.store %sum, %q {access_groups = [#group]} : f32, !llvm.ptr
  } {llvm.loop_annotation = #parallel}
  return
}

// -----

#group = #llvm.access_group<id = distinct[0]<>>
#parallel = #llvm.loop_annotation<parallelAccesses = #group>

// Both sides of a branch without effects are computed. A division of integers
// could end the program, and a load could be out of bounds: their loops are left.
// CHECK-LABEL: func.func @branches(
//       CHECK:   scf.for %{{.+}} = %{{.+}} to %{{.+}} step %c16
//       CHECK:     scf.for
//   CHECK-NOT:       scf.if
// CHECK-COUNT-16:    arith.select
//   CHECK-NOT:       arith.select
//       CHECK:       scf.yield
//       CHECK:   scf.for
//       CHECK:     scf.if
//   CHECK-NOT:   step %c16
//       CHECK:   return
func.func @branches(%a: !llvm.ptr, %lo: index, %hi: index, %n: index) {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  %zero = arith.constant 0.0 : f32
  scf.for %i = %lo to %hi step %c1 {
    %sum = scf.for %j = %c0 to %n step %c1 iter_args(%s = %zero) -> (f32) {
      %other = arith.cmpi ne, %i, %j : index
      %next = scf.if %other -> (f32) {
        %t = arith.addf %s, %s : f32
        scf.yield %t : f32
      } else {
        scf.yield %s : f32
      }
      scf.yield %next : f32
    }
  } {llvm.loop_annotation = #parallel}
  scf.for %i = %lo to %hi step %c1 {
    %sum = scf.for %j = %c0 to %n step %c1 iter_args(%s = %zero) -> (f32) {
      %other = arith.cmpi ne, %i, %j : index
      %next = scf.if %other -> (f32) {
        %t = llvm.load %a {access_groups = [#group]} : !llvm.ptr -> f32
        scf.yield %t : f32
      } else {
        scf.yield %s : f32
      }
      scf.yield %next : f32
    }
  } {llvm.loop_annotation = #parallel}
  scf.for %i = %lo to %hi step %c1 {
    %sum = scf.for %j = %c0 to %n step %c1 iter_args(%s = %zero) -> (f32) {
      %other = arith.cmpi ne, %i, %j : index
      %next = scf.if %other -> (f32) {
        %q = arith.divsi %i, %j : index
        %r = arith.index_cast %q : index to i32
        %t = arith.sitofp %r : i32 to f32
        scf.yield %t : f32
      } else {
        scf.yield %s : f32
      }
      scf.yield %next : f32
    }
  } {llvm.loop_annotation = #parallel}
  return
}

// -----

#group = #llvm.access_group<id = distinct[0]<>>
#parallel = #llvm.loop_annotation<parallelAccesses = #group>

// Each copy reads a row of its own: eight columns at a time, then those left over.
// CHECK-LABEL: func.func @rows(
//       CHECK:   scf.for %{{.+}} = %{{.+}} to %{{.+}} step %c16
//       CHECK:     %[[WHOLE:.+]]:16 = scf.for %{{.+}} iter_args
// CHECK-COUNT-128:   arith.addf
//   CHECK-NOT:       arith.addf
//       CHECK:     scf.for %{{.+}} iter_args(%{{.+}} = %[[WHOLE]]#0
// CHECK-COUNT-16:    arith.addf
//   CHECK-NOT:       arith.addf
//       CHECK:     scf.yield
func.func @rows(%a: !llvm.ptr, %b: !llvm.ptr, %lo: index, %hi: index, %n: index) {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  %zero = arith.constant 0.0 : f32
  scf.for %i = %lo to %hi step %c1 {
    %i64 = arith.index_cast %i : index to i64
    %sum = scf.for %j = %c0 to %n step %c1 iter_args(%s = %zero) -> (f32) {
      %row = arith.muli %i, %n : index
      %at = arith.addi %row, %j : index
      %at64 = arith.index_cast %at : index to i64
      %p = llvm.getelementptr %a[%at64] : (!llvm.ptr, i64) -> !llvm.ptr, f32
      %t = llvm.load %p {access_groups = [#group]} : !llvm.ptr -> f32
      %u = arith.addf %s, %t : f32
      scf.yield %u : f32
    }
    %q = llvm.getelementptr %b[%i64] : (!llvm.ptr, i64) -> !llvm.ptr, f32
    llvm.store %sum, %q {access_groups = [#group]} : f32, !llvm.ptr
  } {llvm.loop_annotation = #parallel}
  return
}

// -----

#group = #llvm.access_group<id = distinct[0]<>>
#parallel = #llvm.loop_annotation<parallelAccesses = #group>

// The terms of one sum are a row apart, those of the iterations side by side, and
// LLVM makes no vectors of its own.
// CHECK-LABEL: func.func @columns(
//       CHECK:   step %c16
// ANY-DAG: #[[$NONE:.+]] = #llvm.loop_vectorize<disable = true>
// ANY-DAG: #[[$ONCE:.+]] = #llvm.loop_annotation<vectorize = #[[$NONE]]>
// ANY-LABEL: func.func @columns(
//       ANY:   step %c16
//       ANY:     scf.for
//       ANY:     } {llvm.loop_annotation = #[[$ONCE]]}
func.func @columns(%a: !llvm.ptr, %b: !llvm.ptr, %lo: index, %hi: index, %n: index) {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  %zero = arith.constant 0.0 : f32
  scf.for %i = %lo to %hi step %c1 {
    %i64 = arith.index_cast %i : index to i64
    %sum = scf.for %j = %c0 to %n step %c1 iter_args(%s = %zero) -> (f32) {
      %row = arith.muli %j, %n : index
      %at = arith.addi %row, %i : index
      %at64 = arith.index_cast %at : index to i64
      %p = llvm.getelementptr %a[%at64] : (!llvm.ptr, i64) -> !llvm.ptr, f32
      %t = llvm.load %p {access_groups = [#group]} : !llvm.ptr -> f32
      %u = arith.addf %s, %t : f32
      scf.yield %u : f32
    }
    %q = llvm.getelementptr %b[%i64] : (!llvm.ptr, i64) -> !llvm.ptr, f32
    llvm.store %sum, %q {access_groups = [#group]} : f32, !llvm.ptr
  } {llvm.loop_annotation = #parallel}
  return
}
