// RUN: tai-opt %s --tai-unroll-and-jam --split-input-file | FileCheck %s
// RUN: tai-opt %s --tai-unroll-and-jam=reassociate --split-input-file | FileCheck %s --check-prefix=ANY

#group = #llvm.access_group<id = distinct[0]<>>
#parallel = #llvm.loop_annotation<parallelAccesses = #group>

// A sum of 1000 terms in f64: few ops, so two vectors of four. Values
// independent of the iteration are computed once. Where any order will do, LLVM
// makes vectors of terms of one sum.
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
func.func @sums(%a: !llvm.ptr, %b: !llvm.ptr, %lo: index, %hi: index) attributes {passthrough = ["tai.lowered"]} {
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
#parallel = #llvm.loop_annotation<parallelAccesses = #group>

// Twelve iterations in f32 fill no vector of sixteen: eight, and a rest.
// CHECK-LABEL: func.func @few(
//       CHECK:   arith.andi %{{.+}}, %c-8
//       CHECK:   scf.for %{{.+}} = %{{.+}} to %{{.+}} step %c8
//       CHECK:     %{{.+}}:8 = scf.for
func.func @few(%a: !llvm.ptr, %b: !llvm.ptr) attributes {passthrough = ["tai.lowered"]} {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  %c12 = arith.constant 12 : index
  %c1000 = arith.constant 1000 : index
  %zero = arith.constant 0.0 : f32
  scf.for %i = %c0 to %c12 step %c1 {
    %i64 = arith.index_cast %i : index to i64
    %sum = scf.for %j = %c0 to %c1000 step %c1 iter_args(%s = %zero) -> (f32) {
      %j64 = arith.index_cast %j : index to i64
      %p = llvm.getelementptr %a[%j64] : (!llvm.ptr, i64) -> !llvm.ptr, f32
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
#other = #llvm.access_group<id = distinct[1]<>>
#parallel = #llvm.loop_annotation<parallelAccesses = #group>

// These are not unrolled: a short sum, which LLVM unrolls; an access of another
// group; one of none; a call; no annotation; a loop that carries no sum.
// CHECK-LABEL: func.func @left(
//   CHECK-NOT:   arith.andi
//       CHECK:   return
func.func @left(%a: !llvm.ptr, %lo: index, %hi: index) attributes {passthrough = ["tai.lowered"]} {
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

// A triangle: what all copies have is jammed, unless it is little, and each copy
// goes on from there, with its sum. In the second nest each copy counts from where
// it begins. As there is a loop for each copy, there are half as many copies.
// CHECK-DAG: #[[$NONE:.+]] = #llvm.loop_unroll<disable = true>
// CHECK-DAG: #[[$REST:.+]] = #llvm.loop_annotation<vectorize = #{{.+}}, unroll = #[[$NONE]]>
// CHECK-LABEL: func.func @triangle(
//       CHECK:   scf.for %[[I:.+]] = %{{.+}} to %{{.+}} step %c8
//       CHECK:     %[[I1:.+]] = arith.addi %[[I]], %{{.+}}
// CHECK-COUNT-8:   arith.cmpi slt
//       CHECK:     arith.minsi
//       CHECK:     %[[WORTH:.+]] = arith.cmpi sge, %{{.+}}, %c8{{.*}} : index
//       CHECK:     %[[COMMON:.+]] = arith.select %[[WORTH]], %{{.+}}, %c0{{.*}} : index
//       CHECK:     %[[END:.+]] = arith.addi %c0, %[[COMMON]]
//       CHECK:     %[[SUMS:.+]]:8 = scf.for %{{.+}} = %c0 to %[[END]]
// CHECK-COUNT-8:     arith.addf
//   CHECK-NOT:       arith.addf
//       CHECK:     scf.for %{{.+}} = %{{.+}} to %[[I]] step %{{.+}} iter_args(%{{.+}} = %[[SUMS]]#0)
//       CHECK:     } {llvm.loop_annotation = #[[$REST]]}
//       CHECK:     scf.for %{{.+}} = %{{.+}} to %[[I1]] step %{{.+}} iter_args(%{{.+}} = %[[SUMS]]#1)
//       CHECK:   scf.for %{{.+}} step %c8
//       CHECK:     scf.for %[[K:.+]] = %c0{{.*}} to %{{.+}} iter_args
// CHECK-COUNT-8:     arith.addi %{{.+}}, %[[K]]
// CHECK-COUNT-8:   scf.for
func.func @triangle(%a: !llvm.ptr, %lo: index, %hi: index, %n: index) attributes {passthrough = ["tai.lowered"]} {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  %zero = arith.constant 0.0 : f32
  scf.for %i = %lo to %hi step %c1 {
    %sum = scf.for %j = %c0 to %i step %c1 iter_args(%s = %zero) -> (f32) {
      %t = llvm.load %a {access_groups = [#group]} : !llvm.ptr -> f32
      %u = arith.addf %s, %t : f32
      scf.yield %u : f32
    }
  } {llvm.loop_annotation = #parallel}
  scf.for %i = %lo to %hi step %c1 {
    %sum = scf.for %j = %i to %n step %c1 iter_args(%s = %zero) -> (f32) {
      %j64 = arith.index_cast %j : index to i64
      %p = llvm.getelementptr %a[%j64] : (!llvm.ptr, i64) -> !llvm.ptr, f32
      %t = llvm.load %p {access_groups = [#group]} : !llvm.ptr -> f32
      %u = arith.addf %s, %t : f32
      scf.yield %u : f32
    }
  } {llvm.loop_annotation = #parallel}
  return
}

// -----

#group = #llvm.access_group<id = distinct[0]<>>
#parallel = #llvm.loop_annotation<parallelAccesses = #group>

// Nor these, whose bounds differ: a beginning that was loaded; little work for
// each load by a loaded index; a loop inside; steps of two.
// CHECK-LABEL: func.func @uneven_left(
//   CHECK-NOT:   arith.andi
//       CHECK:   return
func.func @uneven_left(%a: !llvm.ptr, %b: !llvm.ptr, %lo: index, %hi: index, %n: index) attributes {passthrough = ["tai.lowered"]} {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  %c2 = arith.constant 2 : index
  %zero = arith.constant 0.0 : f32
  scf.for %i = %lo to %hi step %c1 {
    %i64 = arith.index_cast %i : index to i64
    %p = llvm.getelementptr %b[%i64] : (!llvm.ptr, i64) -> !llvm.ptr, i64
    %first = llvm.load %p {access_groups = [#group]} : !llvm.ptr -> i64
    %begin = arith.index_cast %first : i64 to index
    %sum = scf.for %j = %begin to %n step %c1 iter_args(%s = %zero) -> (f32) {
      %t = llvm.load %a {access_groups = [#group]} : !llvm.ptr -> f32
      %u = arith.addf %s, %t : f32
      scf.yield %u : f32
    }
  } {llvm.loop_annotation = #parallel}
  scf.for %i = %lo to %hi step %c1 {
    %sum = scf.for %j = %c0 to %i step %c1 iter_args(%s = %zero) -> (f32) {
      %j64 = arith.index_cast %j : index to i64
      %p = llvm.getelementptr %b[%j64] : (!llvm.ptr, i64) -> !llvm.ptr, i64
      %at = llvm.load %p {access_groups = [#group]} : !llvm.ptr -> i64
      %q = llvm.getelementptr %a[%at] : (!llvm.ptr, i64) -> !llvm.ptr, f32
      %t = llvm.load %q {access_groups = [#group]} : !llvm.ptr -> f32
      %u = arith.addf %s, %t : f32
      scf.yield %u : f32
    }
  } {llvm.loop_annotation = #parallel}
  scf.for %i = %lo to %hi step %c1 {
    %sum = scf.for %j = %c0 to %i step %c1 iter_args(%s = %zero) -> (f32) {
      %part = scf.for %k = %c0 to %n step %c1 iter_args(%r = %s) -> (f32) {
        %t = llvm.load %a {access_groups = [#group]} : !llvm.ptr -> f32
        %u = arith.addf %r, %t : f32
        scf.yield %u : f32
      }
      scf.yield %part : f32
    }
  } {llvm.loop_annotation = #parallel}
  scf.for %i = %lo to %hi step %c1 {
    %sum = scf.for %j = %c0 to %i step %c2 iter_args(%s = %zero) -> (f32) {
      %t = llvm.load %a {access_groups = [#group]} : !llvm.ptr -> f32
      %u = arith.addf %s, %t : f32
      scf.yield %u : f32
    }
  } {llvm.loop_annotation = #parallel}
  return
}

// -----

#group = #llvm.access_group<id = distinct[0]<>>
#parallel = #llvm.loop_annotation<parallelAccesses = #group>

// Two levels; the inner bounds are the same in all iterations of the outermost.
// CHECK-LABEL: func.func @nested(
//       CHECK:   scf.for %{{.+}} = %{{.+}} to %{{.+}} step %c16
//       CHECK:     scf.for %{{.+}} iter_args({{.+}}) -> (f32, f32, f32, f32, f32, f32, f32, f32, f32, f32, f32, f32, f32, f32, f32, f32) {
//       CHECK:       scf.for %{{.+}} iter_args({{.+}}) -> (f32, f32, f32, f32, f32, f32, f32, f32, f32, f32, f32, f32, f32, f32, f32, f32) {
func.func @nested(%a: !llvm.ptr, %lo: index, %hi: index, %n: index) attributes {passthrough = ["tai.lowered"]} {
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
func.func @branches(%a: !llvm.ptr, %lo: index, %hi: index, %n: index) attributes {passthrough = ["tai.lowered"]} {
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

// Each copy reads a row of its own; indices of rows count for nothing. Columns stay
// one after another: vectors of several would be in the way of TransposeColumns.
// CHECK-LABEL: func.func @rows(
//       CHECK:   scf.for %{{.+}} = %{{.+}} to %{{.+}} step %c16
//       CHECK:     scf.for %{{.+}} iter_args
// CHECK-COUNT-16:    arith.addf
//   CHECK-NOT:       arith.addf
//       CHECK:     scf.yield
// CHECK-COUNT-16:  math.tanh
func.func @rows(%a: !llvm.ptr, %b: !llvm.ptr, %lo: index, %hi: index, %n: index) attributes {passthrough = ["tai.lowered"]} {
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
      %second = arith.addi %at, %c1 : index
      %doubled = arith.addi %second, %second : index
      %last = arith.addi %doubled, %c1 : index
      %last64 = arith.index_cast %last : index to i64
      %p2 = llvm.getelementptr %a[%last64] : (!llvm.ptr, i64) -> !llvm.ptr, f32
      %t2 = llvm.load %p2 {access_groups = [#group]} : !llvm.ptr -> f32
      %m = arith.mulf %t, %t2 : f32
      %u = arith.addf %s, %m : f32
      scf.yield %u : f32
    }
    %slot = arith.muli %i, %n : index
    %here = arith.addi %slot, %i : index
    %h = arith.addi %here, %c1 : index
    %h64 = arith.index_cast %h : index to i64
    %tanh = math.tanh %sum : f32
    %q = llvm.getelementptr %b[%h64] : (!llvm.ptr, i64) -> !llvm.ptr, f32
    llvm.store %tanh, %q {access_groups = [#group]} : f32, !llvm.ptr
  } {llvm.loop_annotation = #parallel}
  return
}

// -----

#group = #llvm.access_group<id = distinct[0]<>>
#parallel = #llvm.loop_annotation<parallelAccesses = #group>

// LLVM unrolls either of these; only of the second, which is shorter, the vectors
// are good.
// CHECK-LABEL: func.func @short(
//       CHECK:   scf.for %{{.+}} = %{{.+}} to %{{.+}} step %c16
//       CHECK:   llvm.load
//   CHECK-NOT:   arith.andi
//       CHECK:   return
func.func @short(%a: !llvm.ptr, %lo: index, %hi: index) attributes {passthrough = ["tai.lowered"]} {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  %c24 = arith.constant 24 : index
  %c48 = arith.constant 48 : index
  %zero = arith.constant 0.0 : f32
  scf.for %i = %lo to %hi step %c1 {
    %sum = scf.for %j = %c0 to %c48 step %c1 iter_args(%s = %zero) -> (f32) {
      %j64 = arith.index_cast %j : index to i64
      %p = llvm.getelementptr %a[%j64] : (!llvm.ptr, i64) -> !llvm.ptr, f32
      %t = llvm.load %p {access_groups = [#group]} : !llvm.ptr -> f32
      %m = arith.mulf %t, %t : f32
      %u = arith.addf %s, %m : f32
      scf.yield %u : f32
    }
  } {llvm.loop_annotation = #parallel}
  scf.for %i = %lo to %hi step %c1 {
    %sum = scf.for %j = %c0 to %c24 step %c1 iter_args(%s = %zero) -> (f32) {
      %j64 = arith.index_cast %j : index to i64
      %p = llvm.getelementptr %a[%j64] : (!llvm.ptr, i64) -> !llvm.ptr, f32
      %t = llvm.load %p {access_groups = [#group]} : !llvm.ptr -> f32
      %m = arith.mulf %t, %t : f32
      %u = arith.addf %s, %m : f32
      scf.yield %u : f32
    }
  } {llvm.loop_annotation = #parallel}
  return
}

// -----

#group = #llvm.access_group<id = distinct[0]<>>
#parallel = #llvm.loop_annotation<parallelAccesses = #group>

// Eleven ops: there are registers for one vector of sums.
// CHECK-LABEL: func.func @many(
//       CHECK:   scf.for %{{.+}} = %{{.+}} to %{{.+}} step %c8
func.func @many(%a: !llvm.ptr, %lo: index, %hi: index, %n: index) attributes {passthrough = ["tai.lowered"]} {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  %zero = arith.constant 0.0 : f32
  scf.for %i = %lo to %hi step %c1 {
    %sum = scf.for %j = %c0 to %n step %c1 iter_args(%s = %zero) -> (f32) {
      %at = arith.addi %i, %j : index
      %at64 = arith.index_cast %at : index to i64
      %p = llvm.getelementptr %a[%at64] : (!llvm.ptr, i64) -> !llvm.ptr, f32
      %t = llvm.load %p {access_groups = [#group]} : !llvm.ptr -> f32
      %1 = arith.mulf %t, %t : f32
      %2 = arith.mulf %1, %t : f32
      %3 = arith.mulf %2, %t : f32
      %4 = arith.mulf %3, %t : f32
      %5 = arith.mulf %4, %t : f32
      %6 = arith.mulf %5, %t : f32
      %7 = arith.mulf %6, %t : f32
      %8 = arith.mulf %7, %t : f32
      %9 = arith.mulf %8, %t : f32
      %u = arith.addf %s, %9 : f32
      scf.yield %u : f32
    }
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
func.func @columns(%a: !llvm.ptr, %b: !llvm.ptr, %lo: index, %hi: index, %n: index) attributes {passthrough = ["tai.lowered"]} {
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

// -----

#group = #llvm.access_group<id = distinct[0]<>>
#parallel = #llvm.loop_annotation<parallelAccesses = #group>

// An index of which each step uses the one before twice: 2^48 paths, which are
// not walked one by one.
// ANY-LABEL: func.func @doubled(
//       ANY:   step %c16
func.func @doubled(%a: !llvm.ptr, %lo: index, %hi: index, %n: index) attributes {passthrough = ["tai.lowered"]} {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  %zero = arith.constant 0.0 : f32
  scf.for %i = %lo to %hi step %c1 {
    %sum = scf.for %j = %c0 to %n step %c1 iter_args(%s = %zero) -> (f32) {
      %d1 = arith.addi %j, %j : index
      %d2 = arith.addi %d1, %d1 : index
      %d3 = arith.addi %d2, %d2 : index
      %d4 = arith.addi %d3, %d3 : index
      %d5 = arith.addi %d4, %d4 : index
      %d6 = arith.addi %d5, %d5 : index
      %d7 = arith.addi %d6, %d6 : index
      %d8 = arith.addi %d7, %d7 : index
      %d9 = arith.addi %d8, %d8 : index
      %d10 = arith.addi %d9, %d9 : index
      %d11 = arith.addi %d10, %d10 : index
      %d12 = arith.addi %d11, %d11 : index
      %d13 = arith.addi %d12, %d12 : index
      %d14 = arith.addi %d13, %d13 : index
      %d15 = arith.addi %d14, %d14 : index
      %d16 = arith.addi %d15, %d15 : index
      %d17 = arith.addi %d16, %d16 : index
      %d18 = arith.addi %d17, %d17 : index
      %d19 = arith.addi %d18, %d18 : index
      %d20 = arith.addi %d19, %d19 : index
      %d21 = arith.addi %d20, %d20 : index
      %d22 = arith.addi %d21, %d21 : index
      %d23 = arith.addi %d22, %d22 : index
      %d24 = arith.addi %d23, %d23 : index
      %d25 = arith.addi %d24, %d24 : index
      %d26 = arith.addi %d25, %d25 : index
      %d27 = arith.addi %d26, %d26 : index
      %d28 = arith.addi %d27, %d27 : index
      %d29 = arith.addi %d28, %d28 : index
      %d30 = arith.addi %d29, %d29 : index
      %d31 = arith.addi %d30, %d30 : index
      %d32 = arith.addi %d31, %d31 : index
      %d33 = arith.addi %d32, %d32 : index
      %d34 = arith.addi %d33, %d33 : index
      %d35 = arith.addi %d34, %d34 : index
      %d36 = arith.addi %d35, %d35 : index
      %d37 = arith.addi %d36, %d36 : index
      %d38 = arith.addi %d37, %d37 : index
      %d39 = arith.addi %d38, %d38 : index
      %d40 = arith.addi %d39, %d39 : index
      %d41 = arith.addi %d40, %d40 : index
      %d42 = arith.addi %d41, %d41 : index
      %d43 = arith.addi %d42, %d42 : index
      %d44 = arith.addi %d43, %d43 : index
      %d45 = arith.addi %d44, %d44 : index
      %d46 = arith.addi %d45, %d45 : index
      %d47 = arith.addi %d46, %d46 : index
      %d48 = arith.addi %d47, %d47 : index
      %at = arith.index_cast %d48 : index to i64
      %p = llvm.getelementptr %a[%at] : (!llvm.ptr, i64) -> !llvm.ptr, f32
      %t = llvm.load %p {access_groups = [#group]} : !llvm.ptr -> f32
      %u = arith.addf %s, %t : f32
      scf.yield %u : f32
    }
  } {llvm.loop_annotation = #parallel}
  return
}

// -----

#group = #llvm.access_group<id = distinct[0]<>>
#parallel = #llvm.loop_annotation<parallelAccesses = #group>

// Loops that compare without a sign are left: their bounds may be negative as
// signed numbers.
// CHECK-LABEL: func.func @unsigned(
//   CHECK-NOT:   arith.andi
//       CHECK:   return
func.func @unsigned(%a: !llvm.ptr, %b: !llvm.ptr, %lo: index, %hi: index) attributes {passthrough = ["tai.lowered"]} {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  %c1000 = arith.constant 1000 : index
  %zero = arith.constant 0.0 : f64
  scf.for %i = %lo to %hi step %c1 {
    %i64 = arith.index_cast %i : index to i64
    %sum = scf.for unsigned %j = %c0 to %hi step %c1 iter_args(%s = %zero) -> (f64) {
      %j64 = arith.index_cast %j : index to i64
      %p = llvm.getelementptr %a[%j64] : (!llvm.ptr, i64) -> !llvm.ptr, f64
      %t = llvm.load %p {access_groups = [#group]} : !llvm.ptr -> f64
      %u = arith.addf %s, %t : f64
      scf.yield %u : f64
    }
    %q = llvm.getelementptr %b[%i64] : (!llvm.ptr, i64) -> !llvm.ptr, f64
    llvm.store %sum, %q {access_groups = [#group]} : f64, !llvm.ptr
  } {llvm.loop_annotation = #parallel}
  scf.for unsigned %i = %lo to %hi step %c1 {
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
