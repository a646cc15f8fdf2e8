<!DOCTYPE qgis PUBLIC 'http://mrcc.com/qgis.dtd' 'SYSTEM'>
<qgis version="3.22" styleCategories="Symbology">
 <renderer-v2 forceraster="0" graduatedMethod="GraduatedColor" attr="z_mean" enableorderby="0" referencescale="-1" type="graduatedSymbol" symbollevels="0">
  <ranges>
   <range symbol="0" render="true" lower="0.000000000000000" upper="200.000000000000000" label="0 - 200" />
   <range symbol="1" render="true" lower="200.000000000000000" upper="400.000000000000000" label="200 - 400" />
   <range symbol="2" render="true" lower="400.000000000000000" upper="600.000000000000000" label="400 - 600" />
   <range symbol="3" render="true" lower="600.000000000000000" upper="800.000000000000000" label="600 - 800" />
   <range symbol="4" render="true" lower="800.000000000000000" upper="1000.000000000000000" label="800 - 1000" />
   <range symbol="5" render="true" lower="1000.000000000000000" upper="1200.000000000000000" label="1000 - 1200" />
   <range symbol="6" render="true" lower="1200.000000000000000" upper="1400.000000000000000" label="1200 - 1400" />
   <range symbol="7" render="true" lower="1400.000000000000000" upper="1600.000000000000000" label="1400 - 1600" />
   <range symbol="8" render="true" lower="1600.000000000000000" upper="1800.000000000000000" label="1600 - 1800" />
   <range symbol="9" render="true" lower="1800.000000000000000" upper="2000.000000000000000" label="1800 - 2000" />
   <range symbol="10" render="true" lower="2000.000000000000000" upper="2200.000000000000000" label="2000 - 2200" />
   <range symbol="11" render="true" lower="2200.000000000000000" upper="2400.000000000000000" label="2200 - 2400" />
   <range symbol="12" render="true" lower="2400.000000000000000" upper="2600.000000000000000" label="2400 - 2600" />
   <range symbol="13" render="true" lower="2600.000000000000000" upper="2800.000000000000000" label="2600 - 2800" />
   <range symbol="14" render="true" lower="2800.000000000000000" upper="3000.000000000000000" label="2800 - 3000" />
  </ranges>
  <symbols>
   <symbol name="0" clip_to_extent="1" type="fill" alpha="1" force_rhr="0">
    <layer enabled="1" class="SimpleFill" locked="0" pass="0">
     <Option type="Map">
      <Option name="color" value="59,110,79,255" type="QString" />
      <Option name="joinstyle" value="bevel" type="QString" />
      <Option name="outline_color" value="60,60,60,90" type="QString" />
      <Option name="outline_style" value="solid" type="QString" />
      <Option name="outline_width" value="0.06" type="QString" />
      <Option name="outline_width_unit" value="MM" type="QString" />
      <Option name="style" value="solid" type="QString" />
     </Option>
    </layer>
   </symbol>
   <symbol name="1" clip_to_extent="1" type="fill" alpha="1" force_rhr="0">
    <layer enabled="1" class="SimpleFill" locked="0" pass="0">
     <Option type="Map">
      <Option name="color" value="89,135,92,255" type="QString" />
      <Option name="joinstyle" value="bevel" type="QString" />
      <Option name="outline_color" value="60,60,60,90" type="QString" />
      <Option name="outline_style" value="solid" type="QString" />
      <Option name="outline_width" value="0.06" type="QString" />
      <Option name="outline_width_unit" value="MM" type="QString" />
      <Option name="style" value="solid" type="QString" />
     </Option>
    </layer>
   </symbol>
   <symbol name="10" clip_to_extent="1" type="fill" alpha="1" force_rhr="0">
    <layer enabled="1" class="SimpleFill" locked="0" pass="0">
     <Option type="Map">
      <Option name="color" value="164,127,91,255" type="QString" />
      <Option name="joinstyle" value="bevel" type="QString" />
      <Option name="outline_color" value="60,60,60,90" type="QString" />
      <Option name="outline_style" value="solid" type="QString" />
      <Option name="outline_width" value="0.06" type="QString" />
      <Option name="outline_width_unit" value="MM" type="QString" />
      <Option name="style" value="solid" type="QString" />
     </Option>
    </layer>
   </symbol>
   <symbol name="11" clip_to_extent="1" type="fill" alpha="1" force_rhr="0">
    <layer enabled="1" class="SimpleFill" locked="0" pass="0">
     <Option type="Map">
      <Option name="color" value="144,109,86,255" type="QString" />
      <Option name="joinstyle" value="bevel" type="QString" />
      <Option name="outline_color" value="60,60,60,90" type="QString" />
      <Option name="outline_style" value="solid" type="QString" />
      <Option name="outline_width" value="0.06" type="QString" />
      <Option name="outline_width_unit" value="MM" type="QString" />
      <Option name="style" value="solid" type="QString" />
     </Option>
    </layer>
   </symbol>
   <symbol name="12" clip_to_extent="1" type="fill" alpha="1" force_rhr="0">
    <layer enabled="1" class="SimpleFill" locked="0" pass="0">
     <Option type="Map">
      <Option name="color" value="170,145,129,255" type="QString" />
      <Option name="joinstyle" value="bevel" type="QString" />
      <Option name="outline_color" value="60,60,60,90" type="QString" />
      <Option name="outline_style" value="solid" type="QString" />
      <Option name="outline_width" value="0.06" type="QString" />
      <Option name="outline_width_unit" value="MM" type="QString" />
      <Option name="style" value="solid" type="QString" />
     </Option>
    </layer>
   </symbol>
   <symbol name="13" clip_to_extent="1" type="fill" alpha="1" force_rhr="0">
    <layer enabled="1" class="SimpleFill" locked="0" pass="0">
     <Option type="Map">
      <Option name="color" value="207,193,183,255" type="QString" />
      <Option name="joinstyle" value="bevel" type="QString" />
      <Option name="outline_color" value="60,60,60,90" type="QString" />
      <Option name="outline_style" value="solid" type="QString" />
      <Option name="outline_width" value="0.06" type="QString" />
      <Option name="outline_width_unit" value="MM" type="QString" />
      <Option name="style" value="solid" type="QString" />
     </Option>
    </layer>
   </symbol>
   <symbol name="14" clip_to_extent="1" type="fill" alpha="1" force_rhr="0">
    <layer enabled="1" class="SimpleFill" locked="0" pass="0">
     <Option type="Map">
      <Option name="color" value="244,241,238,255" type="QString" />
      <Option name="joinstyle" value="bevel" type="QString" />
      <Option name="outline_color" value="60,60,60,90" type="QString" />
      <Option name="outline_style" value="solid" type="QString" />
      <Option name="outline_width" value="0.06" type="QString" />
      <Option name="outline_width_unit" value="MM" type="QString" />
      <Option name="style" value="solid" type="QString" />
     </Option>
    </layer>
   </symbol>
   <symbol name="2" clip_to_extent="1" type="fill" alpha="1" force_rhr="0">
    <layer enabled="1" class="SimpleFill" locked="0" pass="0">
     <Option type="Map">
      <Option name="color" value="119,161,105,255" type="QString" />
      <Option name="joinstyle" value="bevel" type="QString" />
      <Option name="outline_color" value="60,60,60,90" type="QString" />
      <Option name="outline_style" value="solid" type="QString" />
      <Option name="outline_width" value="0.06" type="QString" />
      <Option name="outline_width_unit" value="MM" type="QString" />
      <Option name="style" value="solid" type="QString" />
     </Option>
    </layer>
   </symbol>
   <symbol name="3" clip_to_extent="1" type="fill" alpha="1" force_rhr="0">
    <layer enabled="1" class="SimpleFill" locked="0" pass="0">
     <Option type="Map">
      <Option name="color" value="149,184,118,255" type="QString" />
      <Option name="joinstyle" value="bevel" type="QString" />
      <Option name="outline_color" value="60,60,60,90" type="QString" />
      <Option name="outline_style" value="solid" type="QString" />
      <Option name="outline_width" value="0.06" type="QString" />
      <Option name="outline_width_unit" value="MM" type="QString" />
      <Option name="style" value="solid" type="QString" />
     </Option>
    </layer>
   </symbol>
   <symbol name="4" clip_to_extent="1" type="fill" alpha="1" force_rhr="0">
    <layer enabled="1" class="SimpleFill" locked="0" pass="0">
     <Option type="Map">
      <Option name="color" value="180,198,136,255" type="QString" />
      <Option name="joinstyle" value="bevel" type="QString" />
      <Option name="outline_color" value="60,60,60,90" type="QString" />
      <Option name="outline_style" value="solid" type="QString" />
      <Option name="outline_width" value="0.06" type="QString" />
      <Option name="outline_width_unit" value="MM" type="QString" />
      <Option name="style" value="solid" type="QString" />
     </Option>
    </layer>
   </symbol>
   <symbol name="5" clip_to_extent="1" type="fill" alpha="1" force_rhr="0">
    <layer enabled="1" class="SimpleFill" locked="0" pass="0">
     <Option type="Map">
      <Option name="color" value="211,212,153,255" type="QString" />
      <Option name="joinstyle" value="bevel" type="QString" />
      <Option name="outline_color" value="60,60,60,90" type="QString" />
      <Option name="outline_style" value="solid" type="QString" />
      <Option name="outline_width" value="0.06" type="QString" />
      <Option name="outline_width_unit" value="MM" type="QString" />
      <Option name="style" value="solid" type="QString" />
     </Option>
    </layer>
   </symbol>
   <symbol name="6" clip_to_extent="1" type="fill" alpha="1" force_rhr="0">
    <layer enabled="1" class="SimpleFill" locked="0" pass="0">
     <Option type="Map">
      <Option name="color" value="224,211,154,255" type="QString" />
      <Option name="joinstyle" value="bevel" type="QString" />
      <Option name="outline_color" value="60,60,60,90" type="QString" />
      <Option name="outline_style" value="solid" type="QString" />
      <Option name="outline_width" value="0.06" type="QString" />
      <Option name="outline_width_unit" value="MM" type="QString" />
      <Option name="style" value="solid" type="QString" />
     </Option>
    </layer>
   </symbol>
   <symbol name="7" clip_to_extent="1" type="fill" alpha="1" force_rhr="0">
    <layer enabled="1" class="SimpleFill" locked="0" pass="0">
     <Option type="Map">
      <Option name="color" value="213,187,131,255" type="QString" />
      <Option name="joinstyle" value="bevel" type="QString" />
      <Option name="outline_color" value="60,60,60,90" type="QString" />
      <Option name="outline_style" value="solid" type="QString" />
      <Option name="outline_width" value="0.06" type="QString" />
      <Option name="outline_width_unit" value="MM" type="QString" />
      <Option name="style" value="solid" type="QString" />
     </Option>
    </layer>
   </symbol>
   <symbol name="8" clip_to_extent="1" type="fill" alpha="1" force_rhr="0">
    <layer enabled="1" class="SimpleFill" locked="0" pass="0">
     <Option type="Map">
      <Option name="color" value="201,163,108,255" type="QString" />
      <Option name="joinstyle" value="bevel" type="QString" />
      <Option name="outline_color" value="60,60,60,90" type="QString" />
      <Option name="outline_style" value="solid" type="QString" />
      <Option name="outline_width" value="0.06" type="QString" />
      <Option name="outline_width_unit" value="MM" type="QString" />
      <Option name="style" value="solid" type="QString" />
     </Option>
    </layer>
   </symbol>
   <symbol name="9" clip_to_extent="1" type="fill" alpha="1" force_rhr="0">
    <layer enabled="1" class="SimpleFill" locked="0" pass="0">
     <Option type="Map">
      <Option name="color" value="184,144,96,255" type="QString" />
      <Option name="joinstyle" value="bevel" type="QString" />
      <Option name="outline_color" value="60,60,60,90" type="QString" />
      <Option name="outline_style" value="solid" type="QString" />
      <Option name="outline_width" value="0.06" type="QString" />
      <Option name="outline_width_unit" value="MM" type="QString" />
      <Option name="style" value="solid" type="QString" />
     </Option>
    </layer>
   </symbol>
  </symbols>
  <source-symbol>
   <symbol name="0" clip_to_extent="1" type="fill" alpha="1" force_rhr="0">
    <layer enabled="1" class="SimpleFill" locked="0" pass="0">
     <Option type="Map">
      <Option name="color" value="136,136,136,255" type="QString" />
      <Option name="joinstyle" value="bevel" type="QString" />
      <Option name="outline_color" value="60,60,60,90" type="QString" />
      <Option name="outline_style" value="solid" type="QString" />
      <Option name="outline_width" value="0.06" type="QString" />
      <Option name="outline_width_unit" value="MM" type="QString" />
      <Option name="style" value="solid" type="QString" />
     </Option>
    </layer>
   </symbol>
  </source-symbol>
  <colorramp name="[source]" type="gradient">
   <Option type="Map">
    <Option name="color1" value="59,110,79,255" type="QString" />
    <Option name="color2" value="244,241,238,255" type="QString" />
    <Option name="discrete" value="0" type="QString" />
    <Option name="rampType" value="gradient" type="QString" />
    <Option name="stops" value="0.2;143,181,115,255:0.4;229,220,163,255:0.6;196,154,99,255:0.8;140,106,85,255" type="QString" />
   </Option>
   <prop k="color1" v="59,110,79,255" />
   <prop k="color2" v="244,241,238,255" />
   <prop k="discrete" v="0" />
   <prop k="rampType" v="gradient" />
   <prop k="stops" v="0.2;143,181,115,255:0.4;229,220,163,255:0.6;196,154,99,255:0.8;140,106,85,255" />
  </colorramp>
  <classificationMethod id="Custom">
   <symmetricMode enabled="0" astride="0" symmetrypoint="0" />
   <labelFormat labelprecision="4" trimtrailingzeroes="1" format="%1 - %2" />
   <parameters>
    <Option />
   </parameters>
   <extraInformation />
  </classificationMethod>
  <rotation />
  <sizescale />
 </renderer-v2>
</qgis>
