// RUN: tai-run %s --interpret --no-cache --print-field=@x,@seen,@list,@count | FileCheck %s
// RUN: tai-run %s --no-cache --print-field=@x,@seen,@list,@count | FileCheck %s

// Cells become active when they are written to, are visited while they are, and
// read as zero when they are not.

tai.tree @s : !tai.root<pointer<[i: 4], bitmasked<[i: 2], {x: i32}>>>
tai.tree @h : !tai.root<hash<[i: 4], dense<[i: 2], {z: f32}>>>
tai.tree @l : !tai.root<dense<[j: 2], dynamic<[i: 8], chunk 2, {list: i16}>>>
tai.tree @d : !tai.root<dense<[i: 8], {seen: i32}>, {count: i32}>
tai.field @x = @s["x"] : i32, rank 1
tai.field @z = @h["z"] : f32, rank 1
tai.field @list = @l["list"] : i16, rank 2
tai.field @seen = @d["seen"] : i32, rank 1
tai.field @count = @d["count"] : i32, rank 0

// CHECK: @x : 8xi32 = [0, 7, 0, 0, 0, 0, 9, 0]
// CHECK: @seen : 8xi32 = [0, 7, 0, 0, 0, 0, 9, 0]
// CHECK: @list : 8x2xi16 =
// CHECK-NEXT: {{\[\[}}0, 10],
// CHECK-NEXT: [0, 11],
// CHECK-NEXT: [0, 12],
// CHECK: @count : i32 = 1112
tai.kernel @fill() {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  %c3 = arith.constant 3 : index
  %c4 = arith.constant 4 : index
  %c6 = arith.constant 6 : index
  %seven = arith.constant 7 : i32
  %nine = arith.constant 9 : i32
  tai.store %seven, @x[%c1] : i32
  %old = tai.atomic add %nine, @x[%c6] : i32
  tai.store %nine, @x[%c3] : i32
  tai.deactivate @x[%c3] level 2
  %f = arith.constant 1.0 : f32
  tai.store %f, @z[%c4] : f32
  %ten = arith.constant 10 : i16
  %eleven = arith.constant 11 : i16
  %twelve = arith.constant 12 : i16
  %a0 = tai.append %ten, @list[%c1] : i16
  %a1 = tai.append %eleven, @list[%c1] : i16
  %a2 = tai.append %twelve, @list[%c1] : i16
  tai.return
}

// Visits 1 and 6; of the hash table 4 and 5; counts 1000 for x[0], whose block
// is active and whose cell is not, 100 for each cell of z, the length, nothing
// for deactivated cells, and 2 for the last append's place less one.
tai.kernel @visit() {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  %c3 = arith.constant 3 : index
  tai.parallel_for (%i) in @x {
    %v = tai.load @x[%i] : i32
    tai.store %v, @seen[%i] : i32
  }
  %hundred = arith.constant 100 : i32
  tai.parallel_for (%i) in @z {
    %old = tai.atomic add %hundred, @count[] : i32
  }
  %cell = tai.is_active @x[%c0] level 1
  %block = tai.is_active @x[%c0] level 2
  %gone = tai.is_active @x[%c3] level 2
  %all = arith.constant true
  %notCell = arith.xori %cell, %all : i1
  %both = arith.andi %block, %notCell : i1
  %notGone = arith.xori %gone, %all : i1
  %right = arith.andi %both, %notGone : i1
  %thousand = arith.constant 909 : i32
  scf.if %right {
    %old = tai.atomic add %thousand, @count[] : i32
  }
  %n = tai.length @list[%c1]
  %length = arith.index_cast %n : index to i32
  %old = tai.atomic add %length, @count[] : i32
  tai.return
}

func.func @main() {
  tai.launch @fill() : () -> ()
  tai.launch @visit() : () -> ()
  return
}
